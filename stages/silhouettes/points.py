"""Surfaces that stick out of the hull of silhouettes, and where they are put."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

BEYOND = 1.0
"""Px outside a silhouette that are not yet outside: the edge of a mask is as wide."""


def within(silhouettes: Silhouettes, depth: np.ndarray, rig: Rig, view: int) -> np.ndarray:
    """[h, w] float32 metres: a view's depth [h, w], 0 = none; where a point lies outside the others' silhouettes it is
    moved along its ray to the nearest place in their hull, and is 0 where that ray meets no hull."""
    rows, columns = np.nonzero(depth > 0)
    pixels = points_from_integer_centres(np.stack([columns, rows], axis=-1))
    origin, directions = rays(pixels, rig.intrinsics[view], rig.world_to_camera[view])
    z = depth[rows, columns].astype(np.float64)
    others = silhouettes.kept({*silhouettes.views} - {view})
    outside = outside_by(others, origin + directions * z[:, None]) > BEYOND
    near, far = others.ends(origin, directions[outside], (BEYOND, BEYOND), False).T
    z[outside] = np.clip(z[outside], near, far)  # 0 where both are
    out = np.zeros(depth.shape, np.float32)
    out[rows, columns] = z
    return out


def outside_by(silhouettes: Silhouettes, points: np.ndarray) -> np.ndarray:
    """[N] px by which points [N, 3], world metres, lie outside the silhouette that they are farthest from; 0 or less
    inside all that see them, -inf where none does. At the nearest pixel, and no more than `FARTHEST` px are told."""
    found = np.full(len(points), -np.inf, np.float32)
    for s, (width, height) in enumerate(silhouettes.sizes.astype(int)):
        homogeneous = points @ silhouettes.projections[s, :, :3].T + silhouettes.projections[s, :, 3]
        ahead = homogeneous[:, 2] > 1e-9
        at = np.rint(homogeneous[:, :2] / np.where(ahead, homogeneous[:, 2], 1)[:, None])
        seen = np.flatnonzero(ahead & (at >= 0).all(axis=1) & (at < (width, height)).all(axis=1))
        column, row = at[seen].astype(int).T
        found[seen] = np.maximum(found[seen], silhouettes.distance[s, row, column])
    return found
