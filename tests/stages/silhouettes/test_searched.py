"""Where a hull is searched: as far as people may walk between the cameras, whatever stands close to the middle."""

import numpy as np
import pytest

from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius, visual_hull
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask


def with_close_up(rig: Rig, distance: float) -> Rig:
    """The rig and its first camera again, so near the middle."""
    pose = rig.world_to_camera[0].copy()
    pose[:3, 3] *= distance / np.linalg.norm(pose[:3, 3])
    return Rig(
        (*rig.names, "close"),
        *(np.concatenate([a, a[:1]]) for a in (rig.intrinsics, rig.distortion)),
        np.concatenate([rig.world_to_camera, pose[None]]),
        np.concatenate([rig.size, rig.size[:1]]),
    )


@pytest.mark.parametrize("distance", [0.3, 0.6, 1.0])
def test_a_close_up_takes_nobody_away_who_stands_beside_the_middle(distance: float) -> None:
    """A sphere 0.9 m from the middle of a ring of 2 m has a hull with a camera in its midst as without it."""
    rig, place, radius = ring(8), np.array([0.0, 0.9, 0.0]), 0.25
    close = with_close_up(rig, distance)
    for cameras in (rig, close):
        views = range(len(cameras))
        masks = {v: sphere_mask(cameras, v, place, radius) for v in views}
        searched = searched_radius(cameras, list(views), np.zeros(3))
        silhouettes = Silhouettes.of(cameras, masks, np.zeros(3), searched)
        for v in range(8):
            near, _ = visual_hull(cameras, v, masks[v], silhouettes)
            assert (near[masks[v] > 127] > 0).mean() > 0.97


def test_cameras_of_like_distance_are_outside_of_what_is_searched() -> None:
    rig = with_close_up(ring(8), 1.5)
    apart = np.linalg.norm(rig.centres, axis=1)
    assert searched_radius(rig, list(range(9)), np.zeros(3)) == pytest.approx(0.9 * apart.min())
