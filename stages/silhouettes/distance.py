"""How far the pixels of a picture lie outside and inside a silhouette, and the box around it."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.imaging.part import part_around
from posegaussian.storage.model.masks import FOREGROUND, foreground

FARTHEST = 64.0
"""Px outside a silhouette that are told apart."""
TRUE = 0.95
"""Share of its distances that OpenCV's transform over 3 x 3 px is sure of: it errs by 4.5 %, up and down."""


def distance_to_foreground(mask: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[h, w] float32: px by which a pixel lies outside the silhouette, sub-pixel from the soft edge, saturated;
    inside <= 0."""
    out = np.full(mask.shape, FARTHEST, np.float32)
    part = part_around(mask[: size[1], : size[0]] > 0, int(FARTHEST) + 2)  # the rest is farther away than is told apart
    soft, beside = (a[: size[1], : size[0]][part] for a in (mask, out))
    if soft.size:
        steps = cv2.distanceTransform((~foreground(soft)).astype(np.uint8), cv2.DIST_L2, 3)
        _beside_soft(soft, steps, FOREGROUND, beside)
    return out


@compiled
def _beside_soft(soft: np.ndarray, steps: np.ndarray, foreground_above: int, out: np.ndarray) -> None:
    """Fill out [h, w] with px outside a silhouette, from those to its nearest pixel, `steps` [h, w].

    Around the edge the covered share itself says where the silhouette runs: share 1/2 at distance 0.
    """
    half, none, whole, most = np.float32(0.5), np.float32(0), np.float32(255), np.float32(FARTHEST)
    for i in range(soft.shape[0]):
        for j in range(soft.shape[1]):
            edge = half - np.float32(soft[i, j]) / whole
            if soft[i, j] > foreground_above:
                px = min(edge, none)
            elif soft[i, j] > 0:
                px = min(edge, steps[i, j])
            else:
                px = max(steps[i, j] - half, half)
            out[i, j] = min(px, most)


def box(mask: np.ndarray, size: np.ndarray, tolerance: float) -> np.ndarray:
    """[4] x0, y0, x1, y1 in integer-centre px around the foreground, wider by the tolerance, within the picture."""
    inside = foreground(mask[: size[1], : size[0]])
    rows, columns = np.nonzero(inside.any(axis=1))[0], np.nonzero(inside.any(axis=0))[0]
    margin = tolerance + 1.0
    low = np.maximum(np.array([columns[0], rows[0]]) - margin, 0)
    high = np.minimum(np.array([columns[-1], rows[-1]]) + margin, size - 1)
    return np.concatenate([low, high]).astype(np.float64)


def within(distances: np.ndarray) -> np.ndarray:
    """[S, h, w] float32: px by which a pixel lies, at least, within the part of a mask that carves nothing off it;
    beside it, as far as it lies outside the silhouette, negative. `distances` [S, h, w] are those to the
    foreground."""
    out = -0.5 - distances
    for near, distance in zip(out, distances, strict=True):
        inside = distance <= -0.5
        if inside.any():
            part = part_around(inside, 1)  # one px around it is not inside, where there is any
            depth = cv2.distanceTransform(inside[part].astype(np.uint8), cv2.DIST_L2, 3)
            near[part] = np.where(inside[part], np.minimum(TRUE * depth, FARTHEST), near[part])
    return np.asarray(out)
