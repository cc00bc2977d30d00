"""How a person looks: colour histograms of torso and legs, by which who went is known again when they come back.

Affinity of histograms is Bhattacharyya's, as in mean-shift tracking (Comaniciu, Ramesh and Meer, 2003).
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from posegaussian.stages.following.association import SCORE
from posegaussian.storage.model.joint_sets import joint_set

BINS = (12, 4, 4)
"""Of hue, saturation and value."""
PARTS = 2
"""Torso and legs."""
THICK = 0.16
"""Thickness of a leg over the length of thigh and shin."""
FEWEST_PIXELS = 30
"""Pixels of a part below which nothing is said of it."""
SHRINK = 0.8
"""The torso's corners are drawn in towards its middle: joints lie near its outline."""
_NAMES = joint_set("coco17").names
_TORSO = [_NAMES.index(n) for n in ("LShoulder", "RShoulder", "RHip", "LHip")]
_LEGS = [[_NAMES.index(side + n) for n in ("Hip", "Knee", "Ankle")] for side in "LR"]


def look(picture: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """[2, 192] float64 histograms of torso and legs of a person with COCO-17 joints [17, 3] px in a picture [h, w, 3]
    uint8 sRGB, each of sum 1; zeros of a part that is not seen."""
    out = np.zeros((PARTS, int(np.prod(BINS))))
    for part, mask in enumerate((_torso(picture.shape[:2], joints), _legs(picture.shape[:2], joints))):
        if mask is None or int((mask > 0).sum()) < FEWEST_PIXELS:
            continue
        rows, columns = (slice(int(n.min()), int(n.max()) + 1) for n in np.nonzero(mask))
        hsv = cv2.cvtColor(np.ascontiguousarray(picture[rows, columns]), cv2.COLOR_RGB2HSV)
        found = cv2.calcHist([hsv], [0, 1, 2], mask[rows, columns], list(BINS), [0, 180, 0, 256, 0, 256])
        smooth = _smooth(found.astype(np.float64))
        out[part] = (smooth / smooth.sum()).ravel()
    return out


def _smooth(histogram: np.ndarray) -> np.ndarray:
    """A histogram `BINS` in which a colour between two bins counts for both; hue goes round."""
    for axis, mode in enumerate(("wrap", "edge", "edge")):
        wide = np.pad(histogram, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode=mode)  # type: ignore[call-overload]
        before, own, after = (np.take(wide, range(i, i + BINS[axis]), axis=axis) for i in range(3))
        histogram = 0.2 * before + 0.6 * own + 0.2 * after
    return histogram


def likeness(a: np.ndarray, b: np.ndarray) -> float | None:
    """Affinity 0..1 of two people's histograms [2, 192], mean over the parts that both show; None where there is
    none."""
    both = (a.sum(axis=1) > 0) & (b.sum(axis=1) > 0)
    if not both.any():
        return None
    return float(np.sqrt(a[both] * b[both]).sum(axis=1).mean())


def together(looks: list[np.ndarray]) -> np.ndarray:
    """[2, 192] mean of several looks at one person, over those that show a part."""
    if not looks:
        return np.zeros((PARTS, int(np.prod(BINS))))
    total = np.stack(looks).sum(axis=0)
    sums = total.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(total, sums, out=np.zeros_like(total), where=sums > 0))


def _pixel(joints: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(joints[:, :2] - 0.5, -1e4, 1e4)).astype(np.int32)


def _torso(size: tuple[int, int], joints: np.ndarray) -> np.ndarray | None:
    if (joints[_TORSO, 2] < SCORE).any():
        return None
    corners = joints[_TORSO]
    middle = corners[:, :2].mean(axis=0)
    drawn = np.concatenate([middle + SHRINK * (corners[:, :2] - middle), corners[:, 2:]], axis=1)
    mask = np.zeros(size, np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(_pixel(drawn)), 255)
    return mask


def _legs(size: tuple[int, int], joints: np.ndarray) -> np.ndarray | None:
    mask, found = np.zeros(size, np.uint8), False
    for leg in _LEGS:
        for a, b in pairwise(leg):
            if min(joints[a, 2], joints[b, 2]) < SCORE:
                continue
            first, last = _pixel(joints[[a, b]])
            length = float(np.linalg.norm(joints[a, :2] - joints[b, :2]))
            cv2.line(mask, first.tolist(), last.tolist(), 255, max(1, round(THICK * length)))
            found = True
    return mask if found else None
