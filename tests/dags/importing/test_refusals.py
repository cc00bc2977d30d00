"""A data set with a broken file: the command ends with status 2 and a sentence with the file, and leaves nothing."""

from __future__ import annotations

import errno
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app, main
from posegaussian.dags.importing import register
from posegaussian.storage.model.errors import NotWritten
from tests.fuzz import captures

BROKEN = {
    "zju_mocap": ("annots.npy", captures.zju_mocap),
    "dna_rendering": ("0012_01_annots.smc", captures.dna_rendering),
    "people_snapshot": ("camera.pkl", captures.people_snapshot),
    "humman": ("cameras.json", captures.humman),
    "actorshq": ("calibration.csv", captures.actorshq),
    "mvhumannet": ("camera_extrinsics.json", captures.mvhumannet),
    "genebody": ("annots.npy", captures.genebody),
    "panoptic": ("calibration_171204_pose1.json", captures.panoptic),
    "videos": ("camchain.yaml", captures.test_videos.write),
}


@pytest.mark.parametrize("layout", BROKEN)
def test_a_broken_file_is_a_sentence_and_status_2(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    name, make = BROKEN[layout]
    write: Callable[[Path], None] = make
    write(tmp_path / "capture")
    file = tmp_path / "capture" / name
    before = sorted(p for p in (tmp_path / "capture").rglob("*"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 8])
    monkeypatch.chdir(tmp_path)
    command = ["import", layout, str(tmp_path / "capture"), "--sequence", "a", "--archive", str(tmp_path / "archive")]
    monkeypatch.setattr(sys, "argv", ["posegaussian", *command])
    with pytest.raises(SystemExit) as ended:
        main()
    said = " ".join("".join(capfd.readouterr()).split())
    assert ended.value.code == 2, said
    assert "Traceback" not in said
    assert name in said.replace(" ", "")
    assert sorted(p for p in (tmp_path / "capture").rglob("*")) == before
    assert not (tmp_path / "archive" / "a").exists()


def test_an_archive_that_cannot_be_written_is_refused_before_the_capture_is_looked_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures.test_videos.write(tmp_path / "capture")

    def refused(dir: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(dir / "tmp"))

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    monkeypatch.setattr(register, "find_capture", lambda *_: pytest.fail("it looked through the capture"))
    archive = tmp_path / "archive"
    done = CliRunner().invoke(app, ["import", "videos", str(tmp_path / "capture"), "--archive", str(archive)])
    assert isinstance(done.exception, NotWritten)
    assert str(done.exception).startswith(f"cannot write {archive}: there is no permission to write in {tmp_path};")
    assert not archive.exists()
