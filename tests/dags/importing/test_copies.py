"""Files that are copied into the archive: each is there, whatever it is called."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import register
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers import test_dna_rendering
from tests.storage.importers.test_colmap import many_frames
from tests.support import colmap_files, import_capture, ring


def test_a_copy_keeps_files_that_are_called_alike_apart(tmp_path: Path) -> None:
    name = "{n:06d}/{cam}.png"
    colmap_files.write_text(tmp_path / "in" / "sparse" / "0", many_frames(name))
    for v, cam in enumerate(import_capture.NAMES):
        for n in range(3):
            path = tmp_path / "in" / "images" / name.format(cam=cam, n=n)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, np.full((48, 64, 3), 10 * n + v, np.uint8))
    archive = Archive.open(str(tmp_path / "archive"), create=True)
    settings = load_configuration(folder=tmp_path).default
    made, _ = register(archive, "a", find_capture("colmap", tmp_path / "in", {}), settings, copy=True)
    copied = open_source(made.capture, "pictures")
    assert [int(p[0, 0, 0]) for p in copied.read(1, [0, 1, 2])] == [1, 11, 21]


def test_a_file_that_holds_all_cameras_is_copied_once(tmp_path: Path) -> None:
    test_dna_rendering.write(tmp_path / "in")
    archive = Archive.open(str(tmp_path / "archive"), create=True)
    settings = load_configuration(folder=tmp_path).default
    register(archive, "a", find_capture("dna_rendering", tmp_path / "in", {}), settings, copy=True)
    copies = sorted(p.name for p in (tmp_path / "archive").rglob("*.smc"))
    assert copies == ["0012_01.smc", "0012_01_annots.smc"]
    for p in (tmp_path / "in").iterdir():
        p.unlink()
    kept = Archive.open(str(tmp_path / "archive")).sequence("a").capture
    ring.check_pictures(kept, (0, 1, 2), {2: 2})
    ring.check_masks(kept, (0, 1, 2), {2: 2})
