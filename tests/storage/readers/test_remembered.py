"""Files of all frames' joints are parsed once a process, by whichever reader asks, and never when they changed."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers import sources
from posegaussian.storage.readers.sources import open_source


@pytest.fixture
def folder(person_folder: Path, tmp_path: Path) -> Path:
    """A copy of the person, whose files nobody has parsed yet."""
    return Path(shutil.copytree(person_folder, tmp_path / "person"))


def test_joints_are_parsed_once_a_camera(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture, parsed = find_capture("images", folder, {}), []
    assert {s.kind for s in capture.streams("joints") if s is not None} == {"coco"}

    def watched(path: str, view: str | None = None) -> dict[int, sources.Detections]:
        parsed.append(Path(path).name)
        return read_coco(path, view)

    read_coco = sources.read_coco
    monkeypatch.setattr(sources, "read_coco", watched)
    views, frames = range(len(capture.rig)), capture.numbers.tolist()
    read = [[[open_source(capture, "joints").read(v, n) for n in frames] for v in views] for _ in range(2)]
    assert len(parsed) == len(views)
    for once, again in zip(*read, strict=True):
        np.testing.assert_array_equal(np.concatenate(once), np.concatenate(again))
    with pytest.raises(ValueError, match="read-only"):
        read[0][0][0][:] = 0


def test_what_is_remembered_of_a_file_is_not_said_of_a_changed_one(folder: Path) -> None:
    capture = find_capture("images", folder, {})
    open_source(capture, "joints").read(0, 0)
    file = Path(capture.streams("joints")[0].files[0].path)
    file.write_text(file.read_text().replace("0", "1", 1))
    os.utime(file, ns=(1, 1))
    with pytest.raises(SourceError, match="import the capture again"):
        open_source(capture, "joints").read(0, 0)
