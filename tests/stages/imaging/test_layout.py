"""Geometry between captured, calibrated and frames pixels, checked against projection and against OpenCV."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.stages.frames.params import FramesParams
from posegaussian.stages.imaging.camera_mapping import (
    captured_positions,
    distort,
    frames_positions,
    frames_rig,
    frames_size,
    reach,
    undistort,
)
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres, rigid, to_integer_centres
from posegaussian.storage.model.crop import Crop, captured_to_calibrated
from posegaussian.storage.model.errors import ConfigError

LENS = np.array([-0.21, 0.08, 0.0011, -0.0007, 0.004, 0.02, -0.01, 0.002])


def _rig(distortion: np.ndarray = LENS, size: tuple[int, int] = (1088, 1920)) -> Rig:
    k = np.array([[1100.0, 0.0, 541.3], [0.0, 1104.0, 963.8], [0.0, 0.0, 1.0]])
    return Rig(
        ("a", "b"),
        np.stack([k, k]),
        np.stack([distortion, np.zeros(8)]),
        np.stack([rigid(cv2.Rodrigues(np.array([0.1, -0.3, 0.2]))[0], np.array([0.2, -0.1, 3.0]))] * 2),
        np.array([size, size]),
    )


@settings(max_examples=40)
@given(
    st.integers(16, 3000),
    st.floats(0.5, 2.0),
    st.floats(-40, 40),
    st.floats(-0.5, 0.5),
    st.floats(-0.9, 0.9),
    st.floats(-0.5, 0.5),
)
def test_projection_through_the_frames_rig_is_the_warped_captured_position(
    size: int, scale: float, offset: float, x: float, y: float, z: float
) -> None:
    source, params = _rig(), FramesParams(size=size, crop={"a": Crop(scale=scale, offset=(offset, -offset / 2))})
    rig, crop = frames_rig(source, params.size), captured_to_calibrated(source.names, params.crop)
    point = np.array([x, y, z])
    camera = source.world_to_camera[0, :3, :3] @ point + source.world_to_camera[0, :3, 3]
    # What the camera captures, by OpenCV, in the calibrated picture; the video pixel follows by the inverse crop.
    k = to_integer_centres(source.intrinsics[0])
    calibrated = points_from_integer_centres(
        cv2.projectPoints(camera[None, None], np.zeros(3), np.zeros(3), k, source.distortion[0])[0][0, 0]
    )
    captured = (calibrated - crop[0, 1:]) / crop[0, 0]
    projected = rig.intrinsics[0] @ camera
    projected = projected[:2] / projected[2]
    np.testing.assert_allclose(
        captured_positions(projected, rig.intrinsics[0], source.intrinsics[0], source.distortion[0], crop[0]),
        captured,
        atol=1e-6,
    )
    np.testing.assert_allclose(
        frames_positions(captured, rig.intrinsics[0], source.intrinsics[0], source.distortion[0], crop[0]),
        projected,
        atol=1e-5,
    )


@given(st.integers(1, 5000), st.integers(1, 5000), st.integers(16, 6000))
def test_frames_are_never_enlarged_and_keep_their_shape(width: int, height: int, longest: int) -> None:
    w, h = frames_size((width, height), longest)
    assert 1 <= w <= width
    assert 1 <= h <= height
    assert max(w, h) == min(longest, max(width, height))
    assert abs(w * height - h * width) <= 0.5 * max(width, height) or min(w, h) == 1
    assert frames_size((width, height), None) == (width, height)


def test_corners_of_the_picture_stay_corners() -> None:
    source = _rig(np.zeros(8), (1001, 333))
    rig = frames_rig(source, 500)
    np.testing.assert_array_equal(rig.size, [[500, 166], [500, 166]])
    corners = np.array([[0, 0], [500, 166.0]])
    # A picture spans [0, w] in our convention, so scaling keeps its corners whatever the rounding.
    back = captured_positions(
        corners, rig.intrinsics[0], source.intrinsics[0], source.distortion[0], np.array([1.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(back, [[0, 0], [1001, 333]], atol=1e-9)
    assert not rig.distortion.any()


def test_distortion_is_opencv_s() -> None:
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (50, 2))
    expected = cv2.projectPoints(
        np.concatenate([points, np.ones((50, 1))], 1)[:, None], np.zeros(3), np.zeros(3), np.eye(3), LENS
    )[0][:, 0]
    np.testing.assert_allclose(distort(points, LENS), expected, atol=1e-12)
    np.testing.assert_allclose(undistort(expected, LENS), points, atol=1e-8)


def test_a_lens_that_folds_back_has_no_picture_beyond_the_fold() -> None:
    lens = np.array([-0.3, 0, 0, 0, 0, 0, 0, 0.0])
    # r (1 - 0.3 r²) rises until r = 1 / sqrt(0.9).
    assert reach(lens) == pytest.approx(1 / np.sqrt(0.9), abs=1e-3)
    assert reach(np.zeros(8)) == 10.0
    k = np.array([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]])
    positions = captured_positions(np.array([[100.0, 100], [350, 100]]), k, k, lens, np.array([1.0, 0, 0]))
    np.testing.assert_allclose(positions[0], [100, 100])
    assert np.isnan(positions[1]).all()
    assert np.isnan(undistort(np.array([0.9, 0.0]), lens)).all(), "no direction is seen that far out"


def test_a_crop_of_an_unknown_camera_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"'c'.*a, b"):
        captured_to_calibrated(_rig().names, {"c": Crop(scale=2.0)})
