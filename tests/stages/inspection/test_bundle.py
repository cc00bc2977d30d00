"""Poses that fit the joints are found, and they tell an error of the calibration from the scatter of a detector."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from posegaussian.stages.geometry.points import project
from posegaussian.stages.inspection.bundle import pair_error, refit
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of


def rig_and_joints(noise: float) -> tuple[Rig, np.ndarray, np.ndarray]:
    random = np.random.default_rng(2)
    rig = rig_of([camera(on_ring(40.0 * v, 10.0, 3.0), np.zeros(3)) for v in range(4)], (1000, 1000), 1000.0)
    space = np.ones((20, 17, 4))
    space[..., :3] = random.uniform(-0.7, 0.7, (20, 17, 3))
    seen = np.ones((20, 4, 17, 3))
    seen[..., :2] = np.moveaxis(project(rig, space[..., :3])[0], 2, 1) + noise * random.normal(size=(20, 4, 17, 2))
    return rig, seen, space


def turned(rig: Rig, view: int, degrees: float) -> Rig:
    poses = rig.world_to_camera.copy()
    poses[view, :3] = cv2.Rodrigues(np.radians(degrees) * np.array([1.0, 0.3, 0.0]))[0] @ poses[view, :3]
    return replace(rig, world_to_camera=poses)


def test_exact_joints_find_the_exact_poses_up_to_where_the_world_is() -> None:
    rig, seen, space = rig_and_joints(0.0)
    found = refit(turned(rig, 1, 0.5), seen, space)
    assert found is not None
    assert found.after < 1e-6
    assert pair_error(turned(rig, 1, 0.5), found, 0, 1)[0] > 3.5
    assert all(pair_error(rig, found, a, b)[0] < 1e-3 for a in range(4) for b in range(a + 1, 4))
    again = refit(rig, seen, space)
    assert again is not None
    assert again.after < 1e-9
    np.testing.assert_allclose(again.rig.world_to_camera, rig.world_to_camera, atol=1e-9)


def test_an_error_of_a_pose_is_told_from_scatter() -> None:
    """Half a degree is 9 px at this focal length. Pairs without the wrong camera stay below a few standard errors."""
    rig, seen, space = rig_and_joints(8.0)
    found = refit(turned(rig, 1, 0.5), seen, space)
    assert found is not None
    errors = {(a, b): pair_error(turned(rig, 1, 0.5), found, a, b) for a in range(4) for b in range(a + 1, 4)}
    for pair, (off, error) in errors.items():
        assert error < 1.5
        assert (off > 3.5) == (1 in pair), (pair, off)


def test_scatter_alone_is_no_error() -> None:
    rig, seen, space = rig_and_joints(8.0)
    found = refit(rig, seen, space)
    assert found is not None
    assert all(
        pair_error(rig, found, a, b)[0] < 3 * pair_error(rig, found, a, b)[1] for a in range(4) for b in range(a + 1, 4)
    )


def test_too_few_joints_are_not_fitted() -> None:
    rig, seen, space = rig_and_joints(1.0)
    seen[:, 2, :, 2] = 0.0
    assert refit(rig, seen, space) is None
