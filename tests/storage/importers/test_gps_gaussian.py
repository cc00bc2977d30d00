"""The gps_gaussian importer: samples, subjects and frames, inverse depth, and sentences."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source

SIZE = 64
K = np.array([[51.2, 0, 32.0], [0, 51.2, 33.5625], [0, 0, 1]])
"""As the renderer's, f = 0.8 of the side and a principal point below the middle."""
DISTANCE = 2.0


def extrinsic(degrees: float) -> np.ndarray:
    """[3, 4] world to camera, 2 m from (0, 0.85, 0), looking at it; y of the world is up."""
    a = np.radians(degrees)
    centre = np.array([DISTANCE * np.sin(a), 0.85, DISTANCE * np.cos(a)])
    forward = np.array([-np.sin(a), 0.0, -np.cos(a)])
    down = np.array([0.0, -1.0, 0.0])
    r = np.stack([np.cross(down, forward), down, forward])
    return np.column_stack([r, -r @ centre])


def write_view(base: Path, sample: str, view: int, degrees: float, level: int = 0, k: np.ndarray = K) -> None:
    for kind in ("img", "mask", "depth", "parm"):
        (base / kind / sample).mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(base / "img" / sample / f"{view}.jpg"), np.full((SIZE, SIZE, 3), level, np.uint8))
    mask = np.zeros((SIZE, SIZE, 3), np.uint8)
    mask[20:40, 20:40] = 255
    cv2.imwrite(str(base / "mask" / sample / f"{view}.png"), mask)
    depth = np.where(mask[..., 0] > 0, 2.0**15 / DISTANCE, 0).astype(np.uint16)
    cv2.imwrite(str(base / "depth" / sample / f"{view}.png"), depth)
    np.save(base / "parm" / sample / f"{view}_intrinsic.npy", k)
    np.save(base / "parm" / sample / f"{view}_extrinsic.npy", extrinsic(degrees))


def write_sample(base: Path, sample: str, start: float) -> None:
    for view, step in enumerate((0, 22.5, 5, 11.25, 20)):
        write_view(base, sample, view, start + step, 10 * view)
    cv2.imwrite(str(base / "img" / sample / "2_hr.jpg"), np.zeros((2 * SIZE, 2 * SIZE, 3), np.uint8))


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write_sample(tmp_path, "0000_000", 0.0)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("gps_gaussian", base, options)


def test_a_sample_has_two_sources_and_three_targets(base: Path) -> None:
    capture = find(base)
    assert capture.rig.names == ("0", "1", "2", "3", "4")
    assert capture.held_out == ("2", "3", "4")
    for v, degrees in enumerate((0, 22.5, 5, 11.25, 20)):
        a = np.radians(degrees)
        expected = [DISTANCE * np.sin(a), 0.85, DISTANCE * np.cos(a)]
        np.testing.assert_allclose(capture.rig.centres[v], expected, atol=1e-12)
        np.testing.assert_array_equal(capture.rig.intrinsics[v], K)
    depth = next(iter(open_source(capture, "depth_maps").read(1, [0])))
    np.testing.assert_allclose([depth[30, 30], depth[0, 0]], [DISTANCE, 0])
    mask = next(iter(open_source(capture, "masks").read(3, [0])))
    assert (mask[30, 30], mask[0, 0]) == (255, 0)
    np.testing.assert_allclose(find(base, pixel_center="integer").rig.intrinsics[0, :2, 2], K[:2, 2] + 0.5)


def test_a_subject_is_a_ring_of_its_samples(tmp_path: Path) -> None:
    for pid in range(16):
        write_sample(tmp_path, f"0000_{pid:03d}", 22.5 * pid)
    write_sample(tmp_path, "0001_000", 7.0)
    with pytest.raises(
        UserError, match=r"17 samples, whose cameras differ; choose one with --option sample=0000_000, or"
    ):
        find(tmp_path)
    capture = find(tmp_path, sample="0000")
    assert len(capture.rig) == 16 * 4
    assert len(capture.held_out) == 48
    sources = [n for n in capture.rig.names if n not in capture.held_out]
    assert sources == [f"{pid:03d}" for pid in range(16)]
    assert any("all cameras look at one point to 0 degrees" in n for n in capture.notes)
    assert find(tmp_path, sample="0001_000").held_out == ("2", "3", "4")
    with pytest.raises(UserError, match=r"there is no 7 in .*/img; there are 0000_000, 0000_001"):
        find(tmp_path, sample="7")


def test_samples_of_cameras_that_stand_still_are_frames(tmp_path: Path) -> None:
    for n in range(3):
        for v in range(4):
            write_view(tmp_path, f"{n:04d}", v, 30.0 * v, 10 * n + 50 * v)
    capture = find(tmp_path)
    assert (capture.rig.names, capture.numbers.tolist(), capture.held_out) == (("0", "1", "2", "3"), [0, 1, 2], ())
    levels = [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(2, [0, 2])]
    np.testing.assert_allclose(levels, [100, 120], atol=2)  # JPEG


def test_poses_of_the_other_direction_and_millimetres_are_refused(tmp_path: Path) -> None:
    for place, change, said in (
        ("a", lambda m: np.linalg.inv(np.vstack([m, [0, 0, 0, 1]]))[:3], "poses were written in the other direction"),
        ("b", lambda m: m * [1, 1, 1, 1000], "is it in millimetres|at most 1000 m"),
    ):
        for step in range(6):
            write_sample(tmp_path / place, f"0000_{step:03d}", 60.0 * step)
        for path in (tmp_path / place / "parm").rglob("*_extrinsic.npy"):
            np.save(path, change(np.load(path)))
        with pytest.raises(UserError, match=said):
            find(tmp_path / place, sample="0000")


def test_intrinsics_for_another_size_are_refused(tmp_path: Path) -> None:
    for v in range(2):
        write_view(tmp_path, "0000_000", v, 20.0 * v, k=np.diag([2.0, 2, 1]) @ K)
    with pytest.raises(UserError, match="the intrinsics are for pictures of another size"):
        find(tmp_path)


def test_depth_that_wrapped_is_no_distance_of_a_person(base: Path) -> None:
    """0.1 m is 327,680 of 65,536 units."""
    depth = np.full((SIZE, SIZE), 60, np.uint16)
    cv2.imwrite(str(base / "depth" / "0000_000" / "1.png"), depth)
    with pytest.raises(UserError, match=r"camera 1: the median of depth map .* is 546\.\d+ m"):
        find(base)


def test_wrong_files_get_a_sentence(base: Path) -> None:
    place = base / "parm" / "0000_000" / "1_extrinsic.npy"
    whole = np.load(place)
    for array, sentence in (
        (whole[:2], r"extrinsics \(2, 4\); \[3, 3\] and \[3, 4\] expected"),
        (np.where(np.arange(4) == 3, 1e300, whole), "must be finite and within"),
        (whole * 2, "off a rigid one"),
        (np.array({"R": 1}, dtype=object), "arrays of objects are pickles"),
    ):
        np.save(place, array, allow_pickle=True)
        with pytest.raises(UserError, match=sentence):
            find(base)
    place.unlink()
    with pytest.raises(UserError, match="1_extrinsic"):
        find(base)
