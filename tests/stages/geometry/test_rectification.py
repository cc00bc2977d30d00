import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres, project, unproject
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from tests.support.known_geometry import camera, on_ring, rig_of, ring, sphere_depth

ORIGIN = np.zeros(3)
POINTS = np.random.default_rng(1).uniform(-0.6, 0.6, (200, 3))


def pair_at(angle: float, size: tuple[int, int] = (640, 480), focal: float | list[float] = 500.0) -> RectifiedPair:
    return rectify(rig_of([camera(on_ring(0), ORIGIN), camera(on_ring(angle, 12), ORIGIN)], size, focal), 0, 1, ORIGIN)


@pytest.mark.parametrize("angle", [5, 22.5, 45, 60, -22.5, -60])
@pytest.mark.parametrize("focal", [500.0, [500.0, 750.0]])
def test_rows_align_and_disparity_is_depth(angle: float, focal: float | list[float]) -> None:
    pair = pair_at(angle, focal=focal)
    (first, depth), (second, depth1) = (project(POINTS, pair.intrinsics[i], pair.world_to_camera(i)) for i in (0, 1))
    # float64: values of a few hundred px.
    np.testing.assert_allclose(first[:, 1], second[:, 1], atol=1e-10)
    np.testing.assert_allclose(depth, depth1, atol=1e-12)
    np.testing.assert_allclose(pair.disparity(depth), first[:, 0] - second[:, 0], atol=1e-10)
    np.testing.assert_allclose(pair.depth(pair.disparity(depth)), depth, rtol=1e-12)


def test_rotation_is_rigid_and_the_subject_is_in_the_middle_of_both_pictures():
    pair = pair_at(45)
    np.testing.assert_allclose(pair.rotation @ pair.rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(pair.rotation) == pytest.approx(1)
    for which in (0, 1):
        np.testing.assert_allclose(
            project(ORIGIN, pair.intrinsics[which], pair.world_to_camera(which))[0], np.array(pair.size) / 2, atol=1e-9
        )


def test_swapping_the_order_swaps_the_pictures_and_the_sign():
    rig = ring(8)
    forth, back = rectify(rig, 0, 1, ORIGIN), rectify(rig, 1, 0, ORIGIN)
    np.testing.assert_allclose(forth.rotation, back.rotation, atol=1e-14)
    np.testing.assert_allclose(forth.intrinsics, back.intrinsics[::-1], atol=1e-9)
    assert back.baseline == pytest.approx(-forth.baseline)
    assert back.offset == pytest.approx(-forth.offset)


@pytest.mark.parametrize("which", [0, 1])
def test_source_and_rectified_pixels_invert_each_other_and_agree_with_projection(which: int) -> None:
    rig = rig_of([camera(on_ring(0), ORIGIN), camera(on_ring(40), ORIGIN)], (640, 480), 500.0)
    pair = rectify(rig, 0, 1, ORIGIN)
    source, source_depth = project(POINTS, rig.intrinsics[which], rig.world_to_camera[which])
    rectified, rectified_depth = project(POINTS, pair.intrinsics[which], pair.world_to_camera(which))
    pixels, ratio = pair.rectified_pixels(which, source)
    np.testing.assert_allclose(pixels, rectified, atol=1e-9)
    np.testing.assert_allclose(ratio, rectified_depth / source_depth, rtol=1e-12)
    pixels, ratio = pair.source_pixels(which, rectified)
    np.testing.assert_allclose(pixels, source, atol=1e-9)
    np.testing.assert_allclose(ratio, source_depth / rectified_depth, rtol=1e-12)


def test_maps_have_no_half_pixel_bias():
    """A ramp survives: the rectified picture holds, at every pixel centre,
    the source coordinate that the homography names."""
    rig = rig_of([camera(on_ring(0), ORIGIN), camera(on_ring(30), ORIGIN)], (96, 64), 80.0)
    pair = rectify(rig, 0, 1, ORIGIN)
    ramp = pixel_centres((96, 64)).astype(np.float32)
    window = (20, 34, 60, 50)
    seen = cv2.remap(ramp, *pair.maps(0, window), cv2.INTER_LINEAR, borderValue=(-1, -1))
    wanted, _ = pair.source_pixels(0, pixel_centres((60, 50)) + np.array([20, 34]))
    inside = ((wanted > 1) & (wanted < np.array([95, 63]))).all(axis=-1)
    assert inside.sum() > 1000
    # cv2.remap works in steps of 1/32 px; a forgotten half would be 0.5.
    assert np.abs(seen - wanted)[inside].max() <= 1 / 32 + 1e-4
    assert abs((seen - wanted)[inside].mean()) < 2e-3


def test_round_trip_of_true_depth_through_disparity_has_no_bias():
    rig = ring(16, (64, 48), 60.0)
    pair = rectify(rig, 0, 1, ORIGIN)
    depth = sphere_depth(rig, 0, ORIGIN, 0.6)
    known = depth > 0
    source = pixel_centres((64, 48))[known]
    rectified, ratio = pair.rectified_pixels(0, source)
    disparity = pair.disparity(depth[known] * ratio)
    truth, _ = project(
        unproject(depth, rig.intrinsics[0], rig.world_to_camera[0])[known], pair.intrinsics[1], pair.world_to_camera(1)
    )
    np.testing.assert_allclose(rectified[:, 0] - disparity, truth[:, 0], atol=1e-10)


def test_scale_refines_the_grid_and_nothing_else():
    rig = ring(8)
    coarse, fine = rectify(rig, 0, 1, ORIGIN), rectify(rig, 0, 1, ORIGIN, scale=1.5)
    assert fine.size == (144, 144)
    assert fine.focal == pytest.approx(1.5 * coarse.focal)
    assert fine.sensitivity == pytest.approx(coarse.sensitivity)
    assert coarse.source_pixels(0, np.array([48.0, 48]))[0] == pytest.approx(
        fine.source_pixels(0, np.array([72.0, 72]))[0]
    )


def test_what_has_no_rectification_is_an_error():
    same = rig_of([camera(on_ring(0), ORIGIN)] * 2)
    with pytest.raises(ValueError, match="cam0 and cam1 stand 0 m apart"):
        rectify(same, 0, 1, ORIGIN)
    behind = rig_of([camera(on_ring(0, 0), ORIGIN), camera(on_ring(0, 0, 3.0), ORIGIN)])
    with pytest.raises(ValueError, match="no common side"):
        rectify(behind, 0, 1, ORIGIN)
    with pytest.raises(ValueError, match="lies behind"):
        rectify(ring(8), 0, 1, np.array([9.0, 4.0, 0]))
