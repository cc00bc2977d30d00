"""Epipolar lines of two cameras without lens, and how far points lie beside them."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.cameras import Rig


def fundamental(rig: Rig, first: int, second: int) -> np.ndarray:
    """[3, 3] F of two cameras: y^T F x = 0 for homogeneous pixels x of the first and y of the second that show one
    point.

    Hartley and Zisserman, Multiple View Geometry, 9.2: F = K'^-T [t]x R K^-1 with the motion R, t from the first camera
    to the second. All zeros where the centres coincide.
    """
    rotation = rig.rotations[second] @ rig.rotations[first].T
    x, y, z = rig.world_to_camera[second, :3, 3] - rotation @ rig.world_to_camera[first, :3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.linalg.inv(rig.intrinsics[second]).T @ cross @ rotation @ np.linalg.inv(rig.intrinsics[first]))


def homogeneous(points: np.ndarray) -> np.ndarray:
    """[..., 2] -> [..., 3] with a one, float64."""
    points = np.asarray(points, dtype=np.float64)
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)


def signed_epipolar_distance(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] of two cameras and their fundamental matrix -> signed px [...] by which they miss it; 0 where F
    has no line.

    Sampson's distance (Hartley and Zisserman, 11.4.3): to first order, how far the four coordinates must move in all.
    """
    x, y = homogeneous(first), homogeneous(second)
    lines, back = x @ matrix.T, y @ matrix
    slope = np.sqrt((lines[..., :2] ** 2).sum(axis=-1) + (back[..., :2] ** 2).sum(axis=-1))
    return np.where(slope > 0, (y * lines).sum(axis=-1) / np.where(slope > 0, slope, 1.0), 0.0)
