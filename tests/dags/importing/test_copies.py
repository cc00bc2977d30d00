"""Files that are copied into the archive: each is there, whatever it is called."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import register
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import variant
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers import test_dna_rendering
from tests.storage.importers.test_colmap import many_frames
from tests.support import colmap_files, import_capture, ring
from tests.support.pipeline import NAME, Pipeline, film


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


@pytest.mark.parametrize("beside", [False, True])
def test_an_archive_that_holds_its_captures_can_be_moved(tmp_path: Path, beside: bool) -> None:
    """Copied into the sequence, or filmed into the archive, as simulated ones are; with what was computed, and with
    variants, whose records are the sequence's own."""
    there = tmp_path / ("archive/_captures/person" if beside else "person")
    film(there, views=3, size=32, frames=2, held_out=0)
    before = Pipeline(tmp_path / "archive", there, held_out="[]")
    settings = before.configuration.for_sequence(NAME)
    archive = Archive.open(str(before.root), create=True)
    register(archive, NAME, find_capture("images", there, {}), settings, copy=not beside)
    before.run(selection=Selection(only=frozenset({"survey", "frames"})))
    shown = list(open_source(archive.sequence(NAME).capture, "pictures").read(1, [0, 1]))
    variant(archive.sequence(NAME), settings, {"of": "a variant"}, ())
    (tmp_path / "archive").rename(tmp_path / "moved")
    if not beside:
        shutil.rmtree(there)
    moved = Pipeline(tmp_path / "moved", tmp_path / "nowhere", held_out="[]")
    kept = Archive.open(str(moved.root)).sequence(NAME)
    states = {v.task.stage: v.state for v in moved.plan().verdicts.values()}
    assert states["frames"] is State.FRESH
    for capture in (kept.capture, variant(kept, settings, {"of": "a variant"}, ()).capture):
        assert all(Path(f.path).is_relative_to(moved.root) for s in capture.pictures for f in s.files)
        np.testing.assert_array_equal(list(open_source(capture, "pictures").read(1, [0, 1])), shown)
    moved.run(selection=Selection(only=frozenset({"frames"}), force=frozenset({"frames"})))


def test_files_outside_of_the_archive_stay_where_they_are(person_folder: Path, tmp_path: Path) -> None:
    settings = load_configuration(folder=tmp_path).default
    archive = Archive.open(str(tmp_path / "archive"), create=True)
    capture = find_capture("images", person_folder, {})
    register(archive, "a", capture, settings)
    (tmp_path / "archive").rename(tmp_path / "moved")
    assert Archive.open(str(tmp_path / "moved")).sequence("a").capture.pictures == capture.pictures
