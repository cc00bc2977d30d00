"""How much of the subject a path's pictures show: their size, and focal lengths that keep a person whole."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.subject import FILLED
from posegaussian.storage.model.cameras import Rig

CLOSE = 1 / FILLED
"""Times as large as the median camera from which on a camera shows the subject close up: of a person who fills that
one's picture as far as in a capture framed on purpose, it cuts something off."""
ALIKE = 3
"""Decimals to which distances are compared: cameras at about one distance keep their focal lengths."""


def common_size(rig: Rig) -> np.ndarray:
    """[2] px: the size that most pictures have, of several the one with most pixels; where fewer than half have it,
    the largest width and the largest height, so that none of them is cut."""
    counts = (rig.size[:, None] == rig.size).all(axis=2).sum(axis=1)
    if 2 * counts.max() < len(rig):
        return np.asarray(rig.size.max(axis=0))
    best = max(range(len(rig)), key=lambda v: (counts[v], rig.size[v].prod(), rig.size[v, 1]))
    return np.asarray(rig.size[best])


def focal_in(rig: Rig, size: np.ndarray) -> np.ndarray:
    """[V] px: focal lengths of cameras whose whole pictures are scaled into one of `size` [2] px."""
    around = (rig.size * size.max() / size).max(axis=1)  # longer sides of pictures of that shape that hold the cameras'
    return np.asarray(rig.intrinsics[:, [0, 1], [0, 1]].mean(axis=1) * size.max() / around)


def framed(intrinsics: np.ndarray, own: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[3, 3] px: intrinsics [3, 3] of pictures of `own` size [2] px, scaled whole into the middle of one of `size`."""
    scale = (size / own).min()
    out = intrinsics.copy()
    out[:2] *= scale
    out[:2, 2] += (size - scale * own) / 2
    return out


def typical_focal(rig: Rig, size: np.ndarray, distances: np.ndarray, distance: float) -> float:
    """Px: the focal length that shows the subject in pictures of `size` [2] px from `distance` metres as large as the
    median camera does from its own of `distances` [V], of those whose pictures stand or lie like these."""
    like = (rig.size[:, 0] > rig.size[:, 1]) == (size[0] > size[1])
    return float(np.median((focal_in(rig, size) * np.round(distance / distances, ALIKE))[like]))


def without_close_ups(focal: np.ndarray, distances: np.ndarray, views: tuple[int, ...]) -> np.ndarray:
    """[V] px: focal lengths [V] of cameras at `distances` [V] metres; those that show the subject more than `CLOSE`
    times as large as the median of `views` does, the lower one of two, show it as large as that one.

    A close-up is aimed at a face, say, and a path at the middle of the body, which at its focal length would be all
    that is seen.
    """
    shown = focal / distances
    median = np.sort(shown[list(views)])[(len(views) - 1) // 2]
    return np.where(shown > CLOSE * median, median * distances, focal)
