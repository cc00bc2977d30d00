import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.consistency import (
    OFFSETS,
    change_across,
    photometric_disagreement,
    reprojection_residual,
    typical_offset,
)
from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_depth

CENTRE, RADIUS = np.zeros(3), 0.5


@pytest.fixture(scope="module")
def rig() -> Rig:
    return ring(8, (128, 128), 120.0)


def seen(rig: Rig, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Picture and depth of a sphere whose colour is a smooth function of the place on it."""
    depth = sphere_depth(rig, view, CENTRE, RADIUS)
    points = unproject(depth, rig.intrinsics[view], rig.world_to_camera[view])
    color = np.where((depth > 0)[..., None], 128 + 100 * np.sin(9 * points), 0)
    return np.rint(color).astype(np.uint8), depth


def test_joints_projected_by_their_own_cameras_have_no_residual_and_shifted_ones_their_shift(rig: Rig) -> None:
    world = np.hstack([np.random.default_rng(1).uniform(-0.4, 0.4, (17, 3)), np.ones((17, 1))])
    world[3, 3] = 0
    joints = np.stack(
        [
            np.hstack([project(world[:, :3], rig.intrinsics[v], rig.world_to_camera[v])[0], np.ones((17, 1))])
            for v in range(len(rig))
        ]
    )
    joints[2, 5] = (1e4, 1e4, 0)
    residual = reprojection_residual(rig, joints, world)
    assert len(residual) == 16 * len(rig) - 1, "what is unknown in the world or in a view is left out"
    assert residual.max() < 1e-9
    joints[..., :2] += (3.0, 4.0)
    assert reprojection_residual(rig, joints, world) == pytest.approx(5.0)


def test_views_of_one_surface_agree_and_a_gain_or_a_shifted_camera_shows(rig: Rig) -> None:
    (a, za), (b, zb) = seen(rig, 0), seen(rig, 1)
    same = photometric_disagreement(rig, (0, 1), (a, b), (za, zb))
    assert len(same) > 1000
    # Half a step of rounding in each picture and the interpolation of a wave of 700 px/metre.
    assert np.median(same) < 2
    gain = photometric_disagreement(rig, (0, 1), (a, np.clip(b * 1.2, 0, 255).astype(np.uint8)), (za, zb))
    assert np.median(gain) > 15
    off = np.roll(b, 3, axis=1), np.roll(zb, 3, axis=1)
    assert np.median(photometric_disagreement(rig, (0, 1), (a, off[0]), (za, off[1]))) > 3 * np.median(same)


def test_points_that_the_other_view_cannot_see_are_left_out(rig: Rig) -> None:
    (a, za), (b, zb) = seen(rig, 0), seen(rig, 4)
    assert len(photometric_disagreement(rig, (0, 4), (a, b), (za, zb))) < 0.02 * (za > 0).sum(), (
        "opposite views share no surface"
    )
    assert len(photometric_disagreement(rig, (0, 4), (a, b), (np.zeros_like(za), zb))) == 0


@pytest.mark.parametrize("grown", [-2, -1, 0, 1, 2])
def test_an_outline_tells_how_far_it_lies_from_the_edge(grown: int) -> None:
    size, scale = 120, 8
    big = np.zeros((size * scale, size * scale), np.uint8)
    cv2.circle(big, (480, 500), 320, 255, -1)
    exact = cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA)
    color = np.rint(
        exact[..., None] / 255 * np.array([200, 120, 60]) + (1 - exact[..., None] / 255) * np.array([30, 60, 90])
    ).astype(np.uint8)
    big[:] = 0
    cv2.circle(big, (480, 500), 320 + grown * scale, 255, -1)
    mask = cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA)
    # The distance transform knows outlines to a fraction of a pixel.
    assert typical_offset(change_across(color, mask)) == pytest.approx(grown, abs=0.25)


@pytest.mark.parametrize("grown", [-1, 0, 1])
def test_a_pattern_of_the_cloth_moves_no_outline(grown: int) -> None:
    """Squares of 4 px, half as strong as the edge, before a plain wall: at many points some of the change is theirs,
    all points together have the edge where it is."""
    size, scale = 160, 8
    at = np.indices((size, size)) // 4
    cloth = np.where((at.sum(axis=0) % 2 == 0)[..., None], [200, 120, 60], [160, 150, 90])
    big = np.zeros((size * scale, size * scale), np.uint8)
    cv2.ellipse(big, (640, 660), (260, 480), 20, 0, 360, 255, -1)
    exact = cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA)[..., None] / 255
    color = np.rint(exact * cloth + (1 - exact) * np.array([90, 70, 110])).astype(np.uint8)
    big[:] = 0
    cv2.ellipse(big, (640, 660), (260 + grown * scale, 480 + grown * scale), 20, 0, 360, 255, -1)
    change = change_across(color, cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA))
    # Steps of half a px are interpolated; the mask knows its outline to a fraction of a px.
    assert typical_offset(change) == pytest.approx(grown, abs=0.15)
    if grown < 1:
        assert abs(typical_offset(change) - grown) < abs(np.median(change @ OFFSETS) - grown) / 2


def test_without_an_edge_there_is_nothing_to_say() -> None:
    mask = np.zeros((64, 64), np.uint8)
    mask[20:40, 20:40] = 255
    assert len(change_across(np.full((64, 64, 3), 90, np.uint8), mask)) == 0
    assert len(change_across(np.full((64, 64, 3), 90, np.uint8), np.zeros((64, 64), np.uint8))) == 0
