"""Laws of the rounded hull."""

import numpy as np
import pytest

from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius, visual_hull
from posegaussian.stages.silhouettes.rounding import rounded
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_depth, sphere_mask

CENTRE, RADIUS = np.array([0.1, -0.05, 0.1]), 0.5
FOCAL = 205.0
"""Px: 20.5 of them are 0.2 m at 2 m."""


def ends(rig: Rig, view: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True depth of a sphere, near and far end of its hull."""
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(len(rig))}
    silhouettes = Silhouettes.of(rig, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)))
    return sphere_depth(rig, view, CENTRE, RADIUS), *visual_hull(rig, view, masks[view], silhouettes)


def others(rig: Rig, view: int = 0) -> np.ndarray:
    """Directions to the other cameras of a rig about the origin, in the view's axes."""
    towards = np.delete(rig.centres, view, axis=0)
    return np.asarray(towards / np.linalg.norm(towards, axis=1, keepdims=True) @ rig.rotations[view].T)


def prism(cameras: int, depth: float = 1.0, size: int = 61) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """An upright elliptic limb, 0.4 m wide and `depth` times as deep, 2 m away, filmed from afar by a level ring: true
    depth, near and far end of its hull [size, size], and the directions of the other cameras."""
    around = 2 * np.pi * np.arange(1, cameras) / cameras
    around = around[np.abs(np.sin(around)) > 1e-6]  # the camera across sees the same outline
    x = (np.arange(size) - size // 2) * 2.2 / FOCAL
    inside = np.abs(x) < 0.2
    half = np.hypot(0.2 * np.cos(around), 0.2 * depth * np.sin(around))[
        :, None
    ]  # of the limb across each line of sight
    ends = (-x * np.cos(around)[:, None] + np.stack([-half, half])) / np.sin(around)[:, None]
    found = [
        2.2 - 0.2 * depth * np.sqrt(np.maximum(1 - (x / 0.2) ** 2, 0)),
        2.2 + ends.min(axis=0).max(axis=0),
        2.2 + ends.max(axis=0).min(axis=0),
    ]
    true, near, far = (np.tile(np.where(inside, z, 0), (size, 1)).astype(np.float32) for z in found)
    return true, near, far, np.stack([np.sin(around), 0 * around, -np.cos(around)], axis=1)


@pytest.mark.parametrize("depth", [0.6, 1.0, 1.5])
@pytest.mark.parametrize("cameras", [4, 5, 6, 8, 12])
def test_the_hull_of_a_limb_becomes_the_limb(cameras: int, depth: float) -> None:
    true, near, far, directions = prism(cameras, depth)
    found = rounded(near, far, FOCAL, directions)
    rows, columns = np.nonzero(near[20:41])
    before, after = (np.abs(z - true)[20 + rows, columns] for z in (near, found))
    # The last side is all that is made round, and of four cameras there is no other; the place of the outline is known
    # to half a pixel, an eightieth of the limb's width.
    assert after.mean() < (0.4 if cameras == 4 else 1.1) * before.mean()
    assert after.max() <= before.max()


def test_it_lies_within_the_hull_and_touches_it_in_the_middle() -> None:
    _, near, far, directions = prism(4)
    found = rounded(near, far, FOCAL, directions)
    inside = near > 0
    assert (found[inside] >= near[inside]).all()
    assert (found[inside] <= far[inside]).all()
    assert (found[~inside] == 0).all()
    assert found[30, 30] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("views", [4, 12])
def test_a_ball_s_hull_comes_nearer_to_the_ball(views: int) -> None:
    """Though it is no limb: the hull's cones close above and below it."""
    rig = ring(views, (256, 256), 240.0)
    truth, near, far = ends(rig)
    both = (truth > 0) & (near > 0)
    before, after = (np.abs(z - truth)[both].mean() for z in (near, rounded(near, far, 240.0, others(rig))))
    assert after < 0.9 * before


def test_a_hull_of_many_views_stays_as_it_is() -> None:
    """Its rays are short at the outline: nothing is left to round."""
    rig = ring(32, (128, 128), 120.0)
    _, near, far = ends(rig)
    moved = (rounded(near, far, 120.0, others(rig)) - near)[near > 0]
    # A tenth of the radius, at the outline's own pixels; a pixel of this picture is 2 cm there.
    assert np.percentile(moved, 90) < 0.05


def test_the_pictures_edge_is_no_outline() -> None:
    _, near, far, directions = prism(4)
    half = rounded(near[:, 30:], far[:, 30:], FOCAL, directions)
    np.testing.assert_allclose(half[30, :15], rounded(near, far, FOCAL, directions)[30, 30:45], atol=0.02)
    whole = np.full((20, 20), 2.0, np.float32)
    np.testing.assert_array_equal(rounded(whole, whole + 0.4, FOCAL, directions), whole)


def test_nothing_becomes_nothing() -> None:
    nothing, directions = np.zeros((8, 8), np.float32), prism(4)[3]
    np.testing.assert_array_equal(rounded(nothing, nothing, FOCAL, directions), nothing)
