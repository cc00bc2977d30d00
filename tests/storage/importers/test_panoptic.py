"""The panoptic importer: centimetres, HD cameras alone, skew, videos and pictures, and sentences."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture, ring
from tests.support.video_clips import counted, counting_clip

NAMES = ("00_00", "00_02", "00_10")
FRAMES = {0: 0, 100: 1}
"""Instant of the ring by number in names."""


def camera(v: int, **change: Any) -> dict[str, Any]:
    return {
        "name": NAMES[v],
        "type": "hd",
        "resolution": list(ring.SIZE),
        "K": ring.intrinsics(v).tolist(),
        "distCoef": ring.DISTORTION.tolist(),
        "R": ring.rotation(v).tolist(),
        "t": (100 * ring.translation(v)[:, None]).tolist(),
        **change,
    }


def calibrate(base: Path, cameras: Any = None) -> None:
    vga = {**camera(0), "name": "01_01", "type": "vga"}
    listed = [vga, camera(2), camera(0), camera(1)] if cameras is None else cameras
    import_capture.dump(base / "calibration_171204_pose1.json", {"calibDataSource": "x", "cameras": listed})


def write(base: Path) -> None:
    calibrate(base)
    for v, name in enumerate(NAMES):
        for number, n in FRAMES.items():
            ring.write_picture(base / "hdImgs" / name / f"{name}_{number:08d}.jpg", v, n)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("panoptic", base, options)


def test_cameras_and_pictures_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [0, 100], 29.97)
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    assert "1 cameras of other kinds run at other rates and are left out" in capture.notes


def test_videos_are_taken_where_there_are_no_pictures(base: Path) -> None:
    shutil.rmtree(base / "hdImgs")
    (base / "hdVideos").mkdir()
    for name in NAMES[:2]:
        counting_clip(base / "hdVideos" / f"hd_{name}.mp4", 4, ring.SIZE)
    counting_clip(base / "hdVideos" / "hd_00_30.mp4", 4, ring.SIZE)
    capture = find(base)
    assert capture.rig.names == NAMES[:2]
    ring.check_cameras(capture, (0, 1))
    assert counted(next(iter(open_source(capture, "pictures").read(1, [3])))) == 3
    assert "1 HD cameras have no pictures and are left out" in capture.notes
    assert "pictures of camera 00_30 have no calibration and are left out" in capture.notes


def test_a_little_skew_is_left_out_and_much_of_it_the_camera(base: Path) -> None:
    def skewed(v: int, skew: float) -> dict[str, Any]:
        return camera(v, K=(ring.intrinsics(v) + np.array([[0, skew, 0], [0, 0, 0], [0, 0, 0]])).tolist())

    calibrate(base, [skewed(0, 0.5), skewed(1, 40.0), camera(2)])
    capture = find(base)
    assert capture.rig.names == (NAMES[0], NAMES[2])
    ring.check_cameras(capture, (0, 2))
    assert any("camera 00_02 is left out: its skew 40 px would move the picture's edge" in n for n in capture.notes)


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    inverse = [np.linalg.inv(ring.pose(v)) for v in range(3)]
    inverted = [camera(v, R=m[:3, :3].tolist(), t=(100 * m[:3, 3]).tolist()) for v, m in enumerate(inverse)]
    for cameras, said in (
        (inverted, "other direction"),
        ([camera(v, t=ring.translation(v).tolist()) for v in range(3)], "m apart where the files' unit is centimetres"),
        ([camera(v, t=(1000 * ring.translation(v)).tolist()) for v in range(3)], "m apart where"),
        ([camera(v, K=(np.diag([2, 2, 1]) @ ring.intrinsics(v)).tolist()) for v in range(3)], "of another size"),
        ([camera(0, resolution="x")], r"resolution 'x' is not \[width, height\] px"),
        ([camera(0, K=np.full((3, 3), np.nan).tolist())], "is no matrix of intrinsics"),
        ([camera(0), camera(0)], "camera 00_00 is there twice"),
        ([{"name": "00_00", "type": "hd"}], "camera 00_00 has no K, distCoef, R, t, resolution"),
        ([camera(0, type="vga")], "has none of the HD cameras 00_00, 00_02, 00_10"),
        ({}, "has no list of cameras"),
    ):
        calibrate(base, cameras)
        with pytest.raises(UserError, match=said):
            find(base)
    calibrate(base)
    (base / "calibration_other.json").write_text("{}")
    with pytest.raises(UserError, match="holds 2 files calibration_NAME"):
        find(base)
    (base / "calibration_other.json").unlink()
    shutil.rmtree(base / "hdImgs")
    with pytest.raises(UserError, match="no pictures of HD cameras in"):
        find(base)
