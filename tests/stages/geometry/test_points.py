"""Points between captured, calibrated and frames pixels; where a rig looks."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.geometry.points import focus, project, to_frames
from posegaussian.storage.model.cameras import Rig, from_integer_centres, points_from_integer_centres
from tests.support.known_geometry import cut_aside
from tests.support.walking_skeleton import SKELETON, pixels, ring


def lens(rig: Rig, coefficients: list[float]) -> Rig:
    return Rig(
        rig.names,
        rig.intrinsics,
        np.tile(np.pad(coefficients, (0, 8 - len(coefficients))), (len(rig), 1)),
        rig.world_to_camera,
        rig.size,
    )


def test_captured_pixels_reach_frames_pixels_through_crop_lens_and_scale() -> None:
    # OpenCV's own convention
    frames, k = (
        ring(1, size=200),
        np.array([[812.0, 0, 401.0], [0, 808.0, 295.0], [0, 0, 1]]),
    )
    source = lens(
        Rig(
            frames.names,
            from_integer_centres(k)[None],
            frames.distortion,
            frames.world_to_camera,
            np.array([[800, 600]]),
        ),
        [-0.21, 0.08, 0.002, -0.003, 0.01],
    )
    rotation = cv2.Rodrigues(source.rotations[0])[0]
    calibrated = points_from_integer_centres(
        cv2.projectPoints(SKELETON, rotation, source.world_to_camera[0, :3, 3], k, source.distortion[0])[0][:, 0]
    )
    scale, offset = 1.25, np.array([-3.0, 17.0])
    captured = (calibrated - offset) / scale
    out, mapped = to_frames(captured, np.array([scale, *offset]), source, frames, 0)
    assert mapped.all()
    # iterations stop at 1e-12 of a focal length
    np.testing.assert_allclose(out, pixels(frames, SKELETON[None])[0, 0, :, :2], atol=1e-6)


def test_a_rig_without_lens_and_crop_is_the_identity() -> None:
    rig = ring(2)
    points = np.random.default_rng(0).uniform(-50, 300, (3, 5, 2))
    out, mapped = to_frames(points, np.array([1.0, 0, 0]), rig, rig, 1)
    np.testing.assert_allclose(out, points, atol=1e-10)
    assert mapped.shape == (3, 5)
    assert mapped.all()


def test_a_point_no_lens_can_have_made_is_not_mapped() -> None:
    rig = ring(1)
    barrel = lens(rig, [-0.3])  # r (1 - 0.3 r^2) never exceeds 0.703
    far = rig.intrinsics[0, :2, 2] + np.array([[0.9, 0.0], [0.3, 0.0]]) * rig.intrinsics[0, 0, 0]
    out, mapped = to_frames(far, np.array([1.0, 0, 0]), barrel, rig, 0)
    assert mapped.tolist() == [False, True]
    assert (out[0] == 0).all()


def test_projection_agrees_with_the_written_out_one() -> None:
    rig = ring(4)
    found, depth = project(rig, SKELETON)
    np.testing.assert_allclose(np.moveaxis(found, 1, 0), pixels(rig, SKELETON[None])[0, ..., :2], atol=1e-9)
    assert (depth > 1).all()
    assert (project(rig, np.array([100.0, 0, 0]))[1][0]) < 0  # behind the camera on the x axis


def test_the_focus_is_where_the_axes_meet_and_exists_for_one_camera() -> None:
    rig = ring(6)
    rig.intrinsics[:, :2, 2] = rig.size / 2  # the axes go through the middle of the pictures
    np.testing.assert_allclose(focus(rig), [0, 0, 0.9], atol=1e-5)  # the pull to the origin weighs 1e-6
    one = rig.subset([0])
    at = focus(one)
    to_point = at - one.centres[0]
    np.testing.assert_allclose(np.cross(to_point, one.rotations[0, 2]), 0, atol=1e-4)  # on the axis
    assert abs(at @ one.rotations[0, 2]) < 1e-3  # nearest to the origin


def test_the_focus_of_pictures_cut_beside_the_principal_point_is_where_their_middles_meet() -> None:
    np.testing.assert_allclose(focus(cut_aside(ring(6), 30.0)), focus(ring(6)), atol=1e-5)
