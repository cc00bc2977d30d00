"""Mattes that follow a picture's edges: log odds of the foreground, refined to the pixel by colours nearby.

A guided filter lets the sum of what is known beforehand and of what colours tell follow the picture's edges (the
labels' costs are filtered and the cheapest is taken: Hosni et al., "Fast cost-volume filtering", 2011).
"""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.frames.color_likelihood import Plate, color_odds

ROUNDS = 2
WINDOW = 0.12
"""Side of the windows in which colours are compared, metres at the subject."""
EDGE = 0.009
"""Radius of the filter along the picture's edges, metres at the subject."""
FLATNESS = 100.0
"""(1/255)² of variance below which the guided filter sees no edge."""
SMALLEST_PART, SMALLEST_HOLE = 0.005, 0.0005
"""Shares of the foreground below which a part of it, or a hole in it, is noise."""
SOFT_RADIUS, SOFT_GAIN = 2, 1.5
"""Px about which an edge is soft, and by how much it is steeper than the guided filter leaves it."""


def compared_beyond(scale: float) -> int:
    """Px around a subject that its colours are compared with, `scale` px of a metre."""
    return round(0.5 * WINDOW * scale) + 2


def along_edges(
    picture: np.ndarray, prior: np.ndarray, scale: float, plate: Plate | None, colors: float = 1.0
) -> np.ndarray:
    """[h, w] float32 log odds of the foreground in a picture [h, w, 3] uint8, of which `prior` [h, w] is known
    beforehand; scale: px of a metre at the subject; `colors` is the weight of what colours tell."""
    side, radius = max(5, round(WINDOW * scale)) | 1, max(1, round(EDGE * scale))
    smooth = cv2.GaussianBlur(picture, (0, 0), 0.7).astype(np.float32)
    odds = prior
    for _ in range(ROUNDS):
        inside = 1 / (1 + np.exp(-odds))
        told = prior + np.float32(colors) * color_odds(smooth, inside, side, plate)
        odds = cv2.ximgproc.guidedFilter(picture, told, radius, FLATNESS)
    return odds


def without_specks(found: np.ndarray, foretold: np.ndarray) -> np.ndarray:
    """[h, w] bool: without parts that nothing foretold, specks, and specks that are missing."""
    mask = found.astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = stats[:, cv2.CC_STAT_AREA] >= SMALLEST_PART * mask.sum()
    kept &= np.bincount(labels[foretold], minlength=len(kept)) > 0
    kept[0] = False
    mask = kept[labels]
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    filled = stats[:, cv2.CC_STAT_AREA] < SMALLEST_HOLE * mask.sum()
    filled[0] = False
    return mask | filled[labels]


def soft_edge(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Coverage [h, w] uint8 of a mask [h, w] bool: along its edge, what share of a pixel's colour is the subject's."""
    share = cv2.ximgproc.guidedFilter(picture, mask.astype(np.float32), SOFT_RADIUS, FLATNESS)
    return np.rint(255 * np.clip(SOFT_GAIN * (share - 0.5) + 0.5, 0, 1)).astype(np.uint8)


def logit(share: np.ndarray, doubt: float) -> np.ndarray:
    """Log odds of a share 0..1 that is wrong with a probability of `doubt`, however sure it is."""
    p = np.clip(share, doubt, 1 - doubt)
    return np.log(p / (1 - p))


def distance_to(shape: np.ndarray) -> np.ndarray:
    """[h, w] float32 px to the nearest pixel of a shape [h, w] bool, 0 inside; very far where it is empty."""
    return (
        cv2.distanceTransform((~shape).astype(np.uint8), cv2.DIST_L2, 5)
        if shape.any()
        else np.full(shape.shape, 1e6, np.float32)
    )
