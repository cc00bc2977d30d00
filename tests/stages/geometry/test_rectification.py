import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres, project, unproject
from posegaussian.stages.geometry.rectification import STRETCH, RectifiedPair, rectify
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


HELD = [(0.0, 0.0, (30.0, 8.0)), (90.0, 90.0, (30.0, 8.0)), (27.0, -140.0, (30.0, 8.0)), (0.0, 0.0, (0.0, 38.0)),
        (45.0, 45.0, (21.0, 29.0)), (10.0, 190.0, (-15.0, 30.0))]  # fmt: skip
"""Rolls of both cameras, and where the second stands: beside, above, diagonally above the first."""


@pytest.mark.parametrize(("first", "second", "place"), HELD)
def test_however_cameras_are_held_rows_align_and_pixels_come_back(
    first: float, second: float, place: tuple[float, float]
) -> None:
    rig = rig_of([camera(on_ring(0), ORIGIN, first), camera(on_ring(*place), ORIGIN, second)], (640, 360), 400.0)
    forth, back = rectify(rig, 0, 1, ORIGIN), rectify(rig, 1, 0, ORIGIN)
    np.testing.assert_array_equal(forth.rotation, back.rotation)
    seen = [project(POINTS, forth.intrinsics[i], forth.world_to_camera(i)) for i in (0, 1)]
    np.testing.assert_allclose(seen[0][0][:, 1], seen[1][0][:, 1], atol=1e-9)
    np.testing.assert_allclose(forth.disparity(seen[0][1]), seen[0][0][:, 0] - seen[1][0][:, 0], atol=1e-9)
    for which in (0, 1):
        source, ratio = forth.source_pixels(which, seen[which][0])
        np.testing.assert_allclose(source, project(POINTS, rig.intrinsics[which], rig.world_to_camera[which])[0])
        again, inverse = forth.rectified_pixels(which, source)
        np.testing.assert_allclose(again, seen[which][0], atol=1e-8)
        np.testing.assert_allclose(ratio * inverse, 1, rtol=1e-10)


@pytest.mark.parametrize("roll", [0.0, 45.0, 90.0, 123.0])
def test_the_rectified_cameras_of_a_ring_do_not_depend_on_how_it_is_held(roll: float) -> None:
    level, rolled = (rig_of([camera(on_ring(a), ORIGIN, r) for a in range(0, 360, 45)]) for r in (0.0, roll))
    for a, b in ((0, 1), (7, 0), (3, 2)):
        ours, theirs = rectify(rolled, a, b, ORIGIN), rectify(level, a, b, ORIGIN)
        # Beyond a quarter turn a rig held upside down is believed: the rectified pictures stand on their heads.
        sense = -1 if roll > 90 else 1
        np.testing.assert_allclose(ours.rotation[:2], sense * theirs.rotation[:2], atol=1e-12)
        np.testing.assert_allclose(ours.rotation[2], theirs.rotation[2], atol=1e-12)


def test_a_pixel_that_is_drawn_out_beyond_the_bound_is_not_comparable() -> None:
    """The share of the source's area is what a small square of it becomes, measured at its corners."""
    pair = pair_at(60, focal=300.0)
    pixels = pixel_centres((640, 480))[::40, ::40].reshape(-1, 2)
    corners = pixels[:, None] + np.array([[0, 0], [1e-3, 0], [0, 1e-3]])
    moved, ratio = pair.rectified_pixels(0, corners)
    growth = np.abs(np.linalg.det(moved[:, 1:] - moved[:, :1])) / 1e-6
    told = pair.comparable(0, ratio[:, 0])
    clear = (ratio[:, 0] > 0) & (np.abs(growth / STRETCH - 1) > 0.02)
    np.testing.assert_array_equal(told[clear], growth[clear] < STRETCH)
    assert told.any()
    assert not told.all()
