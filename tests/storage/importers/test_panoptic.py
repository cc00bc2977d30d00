"""The panoptic importer: centimetres, HD cameras alone, skew, videos and pictures, and sentences."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.joint_sets import PANOPTIC19
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


def person(where: np.ndarray = ring.POINT) -> np.ndarray:
    """[19, 4] centimetres: joint j lies j cm below a place; joint 4 was not found."""
    out = np.column_stack([100 * where + np.outer(np.arange(19), [0, 1, 0]), np.full(19, 0.75)])
    out[4, 3] = -1
    return out


def scene(base: Path, number: int, bodies: Any) -> None:
    listed = [{"id": who, "joints19": np.ravel(j).tolist()} for who, j in bodies.items()]
    import_capture.dump(
        base / "hdPose3d_stage1_coco19" / f"body3DScene_{number:08d}.json", {"version": 0.7, "bodies": listed}
    )


def with_joints(base: Path) -> None:
    """Body 3 in both frames, body 0 beside it in the first."""
    write(base)
    scene(base, 0, {0: person(ring.PLACE), 3: person()})
    scene(base, 100, {3: person(ring.POINT + np.array([0.02, 0, 0]))})


def find(base: Path, **options: object) -> Capture:
    return find_capture("panoptic", base, options)


def test_cameras_and_pictures_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [0, 100], 29.97)
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    assert "1 cameras of other kinds run at other rates and are left out" in capture.notes


def test_joints_in_space_are_those_of_one_body(base: Path) -> None:
    """Metres in the world of the cameras: projected, the known point lands where its joint is seen."""
    assert any("there are no joints in space" in n for n in find(base).notes)
    with_joints(base)
    capture = find(base)
    reader = open_source(capture, "joints3d")
    assert reader.joint_set == "panoptic19"
    first, second = reader.read(0), reader.read(100)
    np.testing.assert_allclose(first[0], [*ring.POINT, 0.75], atol=1e-12)
    np.testing.assert_allclose(second[0], [*(ring.POINT + np.array([0.02, 0, 0])), 0.75], atol=1e-12)
    assert (first[4] == 0).all()
    assert not reader.read(7).any()
    for v in range(3):
        landed = ring.landing(capture.rig.intrinsics[v], ring.DISTORTION, capture.rig.world_to_camera[v], first[0, :3])
        np.testing.assert_allclose(landed, ring.seen(v) + 0.5, atol=1e-6)
    told = "joints in space: body 3 of 2, ids 0 are left out, and 3 of 3 cameras see it"
    assert told in capture.notes
    chosen = find(base, person=0)
    np.testing.assert_allclose(open_source(chosen, "joints3d").read(0)[0, :3], ring.PLACE, atol=1e-12)
    assert any("1 frames lack it, where the same person may have another id" in n for n in chosen.notes)
    assert PANOPTIC19.names[3:6] == ("LShoulder", "LElbow", "LWrist")
    again = Capture.from_json(json.loads(json.dumps(capture.to_json())))
    np.testing.assert_array_equal(open_source(again, "joints3d").read(0), first)


@pytest.mark.parametrize(
    ("bodies", "said"),
    [
        ({3: person() * [10, 10, 10, 1]}, "lie in no camera's picture; are they of this calibration, in centimetres"),
        ({3: person()[:18]}, "joints19 of body 3 are not 19 times x, y, z and confidence"),
        ({3: person() * [1e9, 1, 1, 1]}, "at most 1000 m|m from"),
    ],
)
def test_joints_that_cannot_be_get_a_sentence(base: Path, bodies: Any, said: str) -> None:
    scene(base, 0, bodies)
    with pytest.raises(UserError, match=said):
        find(base)


def test_a_body_that_is_not_there_is_refused(base: Path) -> None:
    with_joints(base)
    with pytest.raises(UserError, match="option person: no body has the id 9; there are 0, 3"):
        find(base, person=9)
    import_capture.dump(base / "hdPose3d_stage1_coco19" / "body3DScene_00000000.json", {"bodies": [{"id": "a"}]})
    with pytest.raises(UserError, match="the id of a body is 'a'; another whole number each is expected"):
        find(base)


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


def test_intrinsics_are_compared_with_the_size_that_the_file_says(base: Path) -> None:
    """Pictures that were cut beside their principal point are taken with a doubt, and those of another size scaled."""
    cut = ring.intrinsics(1)
    cut[:2, 2] = 0.3 * np.array(ring.SIZE)
    calibrate(base, [camera(0), camera(1, K=cut.tolist()), camera(2)])
    assert any("in 00_02 as if the intrinsics were for pictures of another size" in n for n in find(base).notes)
    twice = [np.diag([2, 2, 1]) @ ring.intrinsics(v) for v in range(3)]
    large = [2 * n for n in ring.SIZE]
    calibrate(base, [camera(v, K=k.tolist(), resolution=large) for v, k in enumerate(twice)])
    assert find(base).rig.size.tolist() == [large] * 3


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
