"""The real captures, where they are: what the importer finds, and that cameras,
joints and pixels agree with each other."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.cameras import to_integer_centres
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.readers.sources import open_source
from tests.support.import_capture import project

SHARED = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "captures"
CROP = {"scale": 1.00741, "offset": [0, -7.06]}

pytestmark = [
    pytest.mark.captures,
    pytest.mark.skipif(not SHARED.is_dir(), reason=f"the real captures are not in {SHARED}"),
]


@pytest.fixture(scope="module")
def balance() -> Capture:
    return find_capture(
        "pose2sim",
        SHARED / "balance",
        {"crop": {"cam01": CROP, "cam02": CROP}, "trc": "keypoints/trc/S00_P00_T01_BalancingTrial_0-100.trc"},
    )


def test_balance_is_found(balance):
    assert balance.rig.names == ("cam01", "cam02", "cam03", "cam04")
    assert balance.frame_rate == 60
    assert balance.numbers.tolist() == list(range(100))
    assert [s.size for s in balance.pictures] == [(1080, 1920)] * 2 + [(1088, 1920)] * 2
    assert (balance.rig.size == [1088, 1920]).all()
    joints = open_source(balance, "joints")
    assert joints.joint_set == "body_25b"
    assert joints.read(2, 52).shape == (0, 25, 3)  # the empty person record
    assert joints.read(2, 51).shape == (1, 25, 3)
    assert json.loads(json.dumps(balance.to_json()))["frame_rate"] == 60


def test_the_letterbox_of_balance_is_found(balance):
    """Scaled by 1080/1088, 7 black rows above and below (README of the captures): 0.5 px at no corner."""
    found = find_capture("pose2sim", SHARED / "balance", {})
    assert set(found.crops) == {"cam01", "cam02"}
    for crop in found.crops.values():
        for corner in ([0, 0], [1080, 1920]):
            np.testing.assert_allclose(
                np.multiply(crop.scale, corner) + crop.offset,
                np.add(np.multiply(1.00741, corner), (0, -7.11)),
                atol=0.1,
            )
    assert any("cam01, cam02" in n and "7 black rows above and 7 black rows below" in n for n in found.notes)
    assert balance.crops["cam01"] == Crop(**CROP)


def test_one_frame_of_h264_and_vp9(balance):
    pictures = open_source(balance, "pictures")
    for v in range(4):
        picture = next(pictures.read(v, [61]))
        assert picture.shape[:2] == (1920, balance.pictures[v].size[0])
        assert 90 < picture.mean() < 130
        # cam01 and cam02 are letterboxed by 7 black rows
        assert (picture[:6].mean() < 8) == (v < 2)


def test_balance_markers_project_onto_its_joints(balance):
    """Frame n of the TRC is frame n of the videos and its axes are (Y, Z, X): one frame or axis off would show."""
    joints, markers = open_source(balance, "joints"), open_source(balance, "joints3d")
    from posegaussian.storage.model.joint_sets import joint_map

    of = joint_map("body_25b", markers.joint_set)

    def residual(shift: int) -> float:
        errors = []
        for n in range(20, 80, 3):
            world = markers.read(n + shift)
            for v in (2, 3):  # the two whose videos are not letterboxed
                found = joints.read(v, n)
                for j in np.flatnonzero(of >= 0) if len(found) else ():
                    if found[0, of[j], 2] > 0.5 and world[j, 3] > 0:
                        m = balance.rig.world_to_camera[v]
                        uv = project(
                            balance.rig.intrinsics[v], balance.rig.distortion[v], m[:3, :3], m[:3, 3], world[j, :3]
                        )
                        errors.append(np.linalg.norm(uv - found[0, of[j], :2]))
        return float(np.median(errors))

    here = residual(0)
    # px; 15.4 measured: the markers were made with the makers' own calibration and from coarse keypoints
    assert here < 20
    assert here < min(residual(-2), residual(2))


def test_balance_by_the_makers_file_misses_by_tens_of_pixels(balance):
    """A transposed rotation, an axis the wrong way round or a wrong unit would be off by hundreds,
    or behind the camera."""
    import cv2

    makers = find_capture(
        "pose2sim",
        SHARED / "balance",
        {"crop": {"cam01": CROP, "cam02": CROP}, "calibration": "calibration_qualisys.qca.txt"},
    )
    assert (makers.rig.size == balance.rig.size).all()
    world = np.concatenate([j[j[:, 3] > 0, :3] for j in map(open_source(balance, "joints3d").read, range(0, 100, 10))])
    for v in range(4):
        seen = []
        for rig in (balance.rig, makers.rig):
            assert ((rig.rotations[v] @ world.T).T + rig.world_to_camera[v, :3, 3])[:, 2].min() > 1
            pixels = cv2.projectPoints(
                world,
                rig.rotations[v],
                rig.world_to_camera[v, :3, 3],
                to_integer_centres(rig.intrinsics)[v],
                rig.distortion[v],
            )
            seen.append(pixels[0].reshape(-1, 2))
        # 9 to 29 px measured
        assert 5 < np.median(np.linalg.norm(seen[0] - seen[1], axis=1)) < 35
        # both lenses are one lens: coefficients divided by 64 would be off by .045 and .14
        np.testing.assert_allclose(
            makers.rig.distortion[v, :2], balance.rig.distortion[[0, 1, 3]][:, :2].mean(axis=0), atol=0.03
        )


def test_desk_is_found():
    desk = find_capture("pose2sim", SHARED / "desk", {})
    assert desk.rig.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    assert (desk.frame_rate, len(desk.numbers)) == (6, 57)
    assert (desk.rig.size == [1280, 720]).all()
    assert next(open_source(desk, "pictures").read(3, [56])).shape == (720, 1280, 3)


def test_desk_is_found_by_its_times():
    plain, timed = (find_capture(layout, SHARED / "desk", {}) for layout in ("pose2sim", "caliscope"))
    assert (timed.frame_rate, len(timed.numbers)) == (6, 57)
    assert timed.rig.digest == plain.rig.digest
    assert timed.pictures == plain.pictures  # nothing was dropped
    assert (
        "frames are matched by sync_index of timestamps.csv; frames of one instant are up to 19.9 ms apart"
        in timed.notes
    )
    assert any("no joints" in n and "xy.csv, stereotriangulated_points.csv" in n for n in timed.notes)


def test_desk_corners_triangulate():
    """Board corners seen in several pictures meet in space: rotations, units and lens models are right."""
    import cv2

    rig = find_capture("caliscope", SHARED / "desk", {}).rig
    k = to_integer_centres(rig.intrinsics)
    seen: dict[tuple[str, str], list[tuple[int, np.ndarray]]] = {}
    with (SHARED / "desk" / "xy.csv").open() as f:
        for r in csv.DictReader(f):
            seen.setdefault((r["sync_index"], r["keypoint_id"]), []).append(
                (int(r["cam_id"]), np.array([float(r["img_loc_x"]), float(r["img_loc_y"])]))
            )
    residuals = []
    for found in [f for f in seen.values() if len(f) > 1][::4]:
        rows = []
        for v, pixel in found:
            x, y = cv2.undistortPoints(pixel[None, None], k[v], rig.distortion[v]).reshape(2)
            p = rig.world_to_camera[v, :3]
            rows += [x * p[2] - p[0], y * p[2] - p[1]]
        point = np.linalg.svd(np.array(rows))[2][-1]
        for v, pixel in found:
            uv = cv2.projectPoints(
                point[None, :3] / point[3], rig.rotations[v], rig.world_to_camera[v, :3, 3], k[v], rig.distortion[v]
            )[0]
            residuals.append(np.linalg.norm(uv.reshape(2) - pixel))
    # the capture's makers report 0.5 to 1.2 px
    assert len(residuals) > 400
    assert np.median(residuals) < 1.2
