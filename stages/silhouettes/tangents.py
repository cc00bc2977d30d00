"""Where two silhouettes end across the baseline: points of their outlines that two cameras must see in one plane.

A plane through both camera centres that just touches the subject touches its silhouette in both pictures (a frontier
point: Cipolla, Astrom and Giblin, "Motion from the frontier of curved surfaces", 1995). So the outermost points of two
outlines, above and below the baseline, lie on each other's epipolar lines whatever the subject's shape is. Of a subject
that a picture cuts off nothing is known on that side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import cv2
import numpy as np

from posegaussian.stages.imaging.small_turns import KINDS, SCATTER, Links, fitted_turns
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres
from posegaussian.storage.model.masks import foreground

Outline = tuple[np.ndarray, np.ndarray]
SPECK = 0.02
"""Area of a part of a mask, over that of its largest part, below which it is dirt."""
MARGIN = 3
"""Px from the picture's border within which an outline may go on beyond it."""
FINER, LARGEST = 2, 2048
"""Outlines are looked for at so many times the mask's resolution, of pictures up to so many px: foreground that ends at
whole pixels says 0.04 to 0.16 px of exact cameras (median of a scene, 512 px), halves of them 0.02 to 0.12, quarters no
less."""
WIDEST = 90.0
"""Degrees about the baseline that a silhouette may take up: a camera that sees the other one beside the subject has no
two sides."""


def outline(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a mask [h, w] uint8: the corners [n, 2] px of the convex hull of its foreground, and which of them [n] lie
    away from the border of the picture."""
    finer = FINER if max(mask.shape) <= LARGEST else 1
    if finer > 1:
        mask = cv2.resize(mask, None, fx=finer, fy=finer, interpolation=cv2.INTER_CUBIC)
    inside = foreground(mask).astype(np.uint8)
    parts, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    areas = [cv2.contourArea(p) for p in parts]
    kept = [p[:, 0] for p, area in zip(parts, areas, strict=True) if area > SPECK * max(areas)]
    if not kept:
        return np.zeros((0, 2)), np.zeros(0, bool)
    corners = cv2.convexHull(np.concatenate(kept))[:, 0].astype(np.float64)
    height, width = mask.shape
    margin = finer * MARGIN
    free = ((corners >= margin) & (corners < np.array([width, height]) - margin)).all(axis=1)
    return points_from_integer_centres(corners) / finer, np.asarray(free)


def touching(
    rig: Rig, views: tuple[int, int], first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Points [n, 2] and [n, 2] px of two cameras, n at most 2, where planes through both touch the silhouettes.

    `first`, `second`: corners of their outlines in px of `rig`, and which are free, as `outline` gives them.
    """
    nothing = np.zeros((0, 2)), np.zeros((0, 2))
    baseline = rig.centres[views[1]] - rig.centres[views[0]]
    if not len(first[0]) or not len(second[0]) or not baseline.any():
        return nothing
    along = baseline / np.linalg.norm(baseline)
    directions = [_directions(rig, v, corners) for v, (corners, _) in zip(views, (first, second), strict=True)]
    towards = sum(d.mean(axis=0) for d in directions)
    across = towards - along * (towards @ along)
    if np.linalg.norm(across) < 1e-6:
        return nothing
    across /= np.linalg.norm(across)
    angles = [np.arctan2(d @ np.cross(along, across), d @ across) for d in directions]
    if max(np.ptp(a) for a in angles) > np.radians(WIDEST):
        return nothing
    ends = [(int(pick(angles[0])), int(pick(angles[1]))) for pick in (np.argmin, np.argmax)]
    known = [(i, j) for i, j in ends if first[1][i] and second[1][j]]
    return first[0][[i for i, _ in known]].reshape(-1, 2), second[0][[j for _, j in known]].reshape(-1, 2)


def turns_of_all(rig: Rig, views: Sequence[int], frames: Sequence[Mapping[int, Outline]]) -> np.ndarray:
    """[V, 3] rad, of `views` alone: the turns that the outermost points of their outlines ask for, and no larger.

    `frames`: by view, corners of its outline in px of `rig`, and which are free, as `outline` gives them.
    """
    turns, cameras = np.zeros((len(rig), 3)), rig.subset(views)
    ends = [
        (pair, *touching(cameras, pair, of_view[views[pair[0]]], of_view[views[pair[1]]]))
        for of_view in frames
        for pair in combinations(range(len(views)), 2)
    ]
    pairs = np.array([pair for pair, first, _ in ends for _ in first], int).reshape(-1, 2)
    first, second = (np.concatenate([np.zeros((0, 2)), *(e[side] for e in ends)]) for side in (1, 2))
    kind = np.full(len(pairs), KINDS.index("outlines"))
    links = Links(
        pairs,
        _homogeneous(cameras, pairs[:, 0], first),
        _homogeneous(cameras, pairs[:, 1], second),
        np.full(len(pairs), SCATTER[0]),
        kind,
    )
    turns[list(views)] = fitted_turns(cameras, links)
    return turns


def _directions(rig: Rig, view: int, pixels: np.ndarray) -> np.ndarray:
    """[n, 3] unit directions in the world of pixels [n, 2]."""
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(rig.intrinsics[view]).T
    rays = rays @ rig.rotations[view]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _homogeneous(rig: Rig, views: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """[n, 3] (x, y, 1) of pixels [n, 2] of a view each, in its axes."""
    ends = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.inv(rig.intrinsics)[views], ends))
