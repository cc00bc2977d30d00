"""Joints as heatmaps hold them, and how far off, how restless and how late they are."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.pose.heatmaps import CELL
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

SLOW = 0.005
"""Metres a frame, root of the mean square, below which nothing can be said about lag."""


def off_heatmaps(maps: np.ndarray) -> np.ndarray:
    """[..., J, 3] (u, v, score) px of heatmaps [..., J, rows, columns]: the middle of what rises above half of the
    peak, and its height."""
    values = maps.astype(np.float64)
    peak = values.max(axis=(-2, -1))
    above = np.maximum(values - 0.5 * peak[..., None, None], 0.0)
    mass = np.where(peak > 0, above.sum(axis=(-2, -1)), 1.0)
    v, u = (CELL * points_from_integer_centres(np.arange(n)) for n in maps.shape[-2:])
    return np.stack([above.sum(axis=-2) @ u / mass, above.sum(axis=-1) @ v / mass, peak], axis=-1)


def in_space(rig: Rig, joints: np.ndarray, min_score: float, max_residual: float) -> np.ndarray:
    """[F, J, 4] joints [F, V, J, 3] triangulated, every frame by itself and nothing mended."""
    return np.stack([triangulate(rig, j, min_score, max_residual) for j in joints])


def measures(points: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """Of found joints [F, 17, 4] against true ones [F, 17, 3], over known ones: errors and jitter in mm, lag in frames.

    Jitter is the mean length of the error's second difference from frame to frame. Lag is the t that explains most of
    the error by the joints' own velocity: the least squares solution of found(f) = true(f) - t true'(f), velocities by
    central differences; None for a body that hardly moves.
    """
    known = points[..., 3] > 0
    error = np.where(known[..., None], points[..., :3] - truth, 0.0)
    length = 1000 * np.linalg.norm(error, axis=-1)
    three = known[:-2] & known[1:-1] & known[2:]
    second = 1000 * np.linalg.norm(error[:-2] - 2 * error[1:-1] + error[2:], axis=-1)
    velocity = np.where(known[1:-1, :, None], (truth[2:] - truth[:-2]) / 2, 0.0)
    return {
        "known": float(known.mean()),
        "MPJPE mm": float(length[known].mean()),
        "median mm": float(np.median(length[known])),
        "95 % mm": float(np.percentile(length[known], 95)),
        "jitter mm": float(second[three].mean()),
        "lag frames": (
            None
            if np.sqrt((velocity**2).sum(axis=-1).mean()) < SLOW
            else float(-(error[1:-1] * velocity).sum() / (velocity**2).sum())
        ),
    }
