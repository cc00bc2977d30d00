"""Walks along rays end, whatever the cameras' numbers are: a step is never so small that a ray takes for ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.rendering.clipping import cover
from posegaussian.stages.silhouettes.agreement import agreement
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius, visual_hull
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask

CENTRE = np.array([0.1, -0.05, 0.1])


def silhouettes(focal: float, far: float = 0.0) -> tuple[Rig, dict[int, np.ndarray], Silhouettes]:
    """Five views of a sphere, of which one's calibration says another focal length, px, and another distance, m."""
    rig = ring(5)
    masks = {v: sphere_mask(rig, v, CENTRE, 0.5) for v in range(5)}
    intrinsics, pose = rig.intrinsics.copy(), rig.world_to_camera.copy()
    intrinsics[0, [0, 1], [0, 1]] = focal
    pose[0, 2, 3] += far
    wrong = replace(rig, intrinsics=intrinsics, world_to_camera=pose)
    return wrong, masks, Silhouettes.of(wrong, masks, np.zeros(3), searched_radius(wrong, list(masks), np.zeros(3)))


@pytest.mark.timeout(60)
@pytest.mark.parametrize(("focal", "far"), [(1e12, 0.0), (1e300, 0.0), (1e12, 1e18)])
def test_a_focal_length_beyond_all_bounds_ends_every_walk(focal: float, far: float) -> None:
    rig, masks, found = silhouettes(focal, far)
    assert set(agreement(rig, masks, found).carving) <= set(range(5))
    near, _ = visual_hull(rig, 1, masks[1], found)
    assert np.isfinite(near).all()
    camera = Camera(rig.intrinsics[1], rig.world_to_camera[1], int(rig.size[1, 0]), int(rig.size[1, 1]))
    assert np.isfinite(cover(found, camera, masks[1] > 0)).all()
