"""Points of the visual hull that two cameras see: what shows the same in both, roughly, where a surface has no features
and nothing stands around it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.geometry.projection import project, rays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

ASKED = 8000
"""Pixels of a picture that are asked, about."""
SAME_SURFACE = 0.008
"""Share of its distance by which a point of the hull may lie behind what the second camera sees there: 2 cm at 2.5 m.
"""


def shared_points(
    rig: Rig, pair: tuple[int, int], asked: Mapping[int, np.ndarray], silhouettes: Silhouettes
) -> tuple[np.ndarray, np.ndarray]:
    """Px [n, 2] of the first and of the second camera of a rig without lens, at which they see the same point of the
    hull.

    `asked` [h, w] bool by view: pixels that may be taken. Where a camera stands, the others' silhouettes say how far
    the hull is; `silhouettes` may hold its own, which cannot carve its own rays.
    """
    first, second = pair
    rows, columns = np.nonzero(asked[first])
    some = slice(None, None, max(1, len(rows) // ASKED))
    pixels = points_from_integer_centres(np.stack([columns[some], rows[some]], axis=-1))
    origin, directions = rays(pixels, rig.intrinsics[first], rig.world_to_camera[first])
    near = _hull(silhouettes, first, origin, directions)
    at, depth = project(origin + near[:, None] * directions, rig.intrinsics[second], rig.world_to_camera[second])
    seen = (near > 0) & (depth > 0) & ((at >= 0) & (at < asked[second].shape[::-1])).all(axis=-1)
    seen[seen] = asked[second][tuple(np.floor(at[seen]).astype(int).T[::-1])]
    pixels, at, depth = pixels[seen], at[seen], depth[seen]
    there = _hull(silhouettes, second, *rays(at, rig.intrinsics[second], rig.world_to_camera[second]))
    same = np.abs(there - depth) <= SAME_SURFACE * depth
    return pixels[same], at[same]


def _hull(silhouettes: Silhouettes, view: int, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[n] depth at which a camera's rays enter the hull of the others, 0 where they miss it."""
    return silhouettes.ends(origin, directions, without=view)[:, 0]
