"""Points against silhouettes: of a sphere they tell how far beside it a camera sees them, and are moved into it."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.projection import unproject
from posegaussian.stages.silhouettes.distance import FARTHEST
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.points import outside_by, within
from tests.support.known_geometry import ring, sphere_depth, sphere_mask

CENTRE, RADIUS = np.zeros(3), 0.5


def test_points_beside_a_sphere_lie_as_many_px_outside() -> None:
    rig = ring(6)
    silhouettes = Silhouettes.of(rig, {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(len(rig))}, CENTRE, 1.0)
    along, away = rig.rotations[0, 0], np.linalg.norm(rig.centres[0])  # to the right in camera 0
    rim, pixel = RADIUS * away / np.sqrt(away**2 - RADIUS**2), away / rig.intrinsics[0, 0, 0]
    points = np.stack([CENTRE, *(along * (rim + px * pixel) for px in (-3, 4, 8)), along * 1e6])
    inside, near_edge, four, eight, unseen = outside_by(silhouettes, points)
    assert inside <= 0
    assert near_edge <= 0.5
    assert abs(four - 4) < 1
    assert abs(eight - 8) < 1
    assert unseen <= FARTHEST
    assert outside_by(silhouettes.kept(set()), points).max() == -np.inf


def test_a_point_behind_every_camera_is_nobodys() -> None:
    rig = ring(1)
    silhouettes = Silhouettes.of(rig, {0: sphere_mask(rig, 0, CENTRE, RADIUS)}, CENTRE, 1.0)
    assert outside_by(silhouettes, rig.centres - 2 * rig.rotations[:, 2])[0] == -np.inf


def test_depth_that_sticks_out_of_the_hull_is_moved_into_it() -> None:
    rig = ring(6)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(len(rig))}
    silhouettes = Silhouettes.of(rig, masks, CENTRE, 1.0)
    true = sphere_depth(rig, 0, CENTRE, RADIUS).astype(np.float32)
    found = true.copy()
    rows, columns = np.nonzero(sphere_depth(rig, 0, CENTRE, 0.9 * RADIUS))  # whose rays surely meet the hull
    near, far = (rows[0], columns[0]), (rows[-1], columns[-1])
    found[near] -= 0.7
    found[far] += 2.5
    found[0, 0] = 2.0  # beside everything
    moved = within(silhouettes, found, rig, 0)
    pixel = 2.0 / rig.intrinsics[0, 0, 0]
    untouched = true > 0
    untouched[near] = untouched[far] = False
    np.testing.assert_allclose(moved[untouched], true[untouched], atol=2 * pixel)
    assert true[near] - 6 * pixel < moved[near] <= true[near] + pixel
    assert true[far] < moved[far] < true[far] + 2.2 * RADIUS
    assert moved[0, 0] == 0
    assert outside_by(silhouettes, unproject(moved, rig.intrinsics[0], rig.world_to_camera[0])[moved > 0]).max() < 2
