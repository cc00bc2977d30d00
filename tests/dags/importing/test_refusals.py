"""A data set with a broken file: the command ends with status 2 and a sentence with the file, and leaves nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from posegaussian.dags.cli.app import main
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
