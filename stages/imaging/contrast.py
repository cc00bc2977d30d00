"""Whether a picture shows anything at all."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.masks import foreground

SMOOTHED = 9
"""Px over which a picture is averaged before its contrast is taken, so that noise counts as none."""
SPREAD = (2, 98)
"""Percentiles between which contrast is taken."""
QUARTILES = (25, 75)
"""Percentiles of what lies around a subject that it is compared with: bars and a burnt-in time stamp are less."""
BURNT_OUT = 240
"""Brightness, of 255, from which on a subject is white as a lamp in the lens makes it, with noise."""

NOTHING_AT_ALL = 4.0
"""Brightness, of 255, within which a single picture varies that shows nothing: black, white or grey, with noise of 12,
by 2 at most; a person in plain dark clothes, seen from behind, by 5, and what is around stands out from them."""


def shows_nothing(picture: np.ndarray, mask: np.ndarray) -> bool:
    """Whether a picture [h, w, 3] uint8 has next to no `contrast` where a mask [h, w] says that the subject is: a frame
    that was dropped, or a flash. Of an empty mask that cannot be told."""
    found = contrast(picture, mask)
    return found is not None and found < NOTHING_AT_ALL


def contrast(picture: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """By how much a picture [h, w, 3] uint8 varies in brightness, 1/255 sRGB: between its second and 98th percentile,
    of averages over a few pixels. With a mask [h, w] of its size inside that, or by how much what is inside stands out
    against what lies in a box around it, if that is more; None where the mask is empty.

    A lens cap, a lamp in the lens, a stuck grey: next to nothing. A person in plain dark clothes, seen from behind,
    varies as little, and stands out.
    """
    smooth = cv2.blur(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), (SMOOTHED, SMOOTHED))
    if mask is None or mask.shape != smooth.shape:
        return _spread(smooth)
    inside = foreground(mask).astype(np.uint8)
    if not inside.any():
        return None
    # Averages at the rim hold what lies behind; a mask that is thinner than that keeps its rim.
    inner = cv2.erode(inside, np.ones((SMOOTHED, SMOOTHED), np.uint8))
    seen = smooth[(inner if inner.any() else inside) > 0]
    return max(_spread(seen), _standing_out(float(np.median(seen)), smooth, inside))


def _standing_out(level: float, smooth: np.ndarray, inside: np.ndarray) -> float:
    """By how much the brightness of a subject differs from a quartile of what lies around it, in a box a few pixels
    larger than the mask [h, w] of 0 and 1; 0 of white, which stands out against black by the mask alone where pictures
    are cut out."""
    x, y, width, height = cv2.boundingRect(inside)
    by = SMOOTHED // 2
    box = np.s_[max(0, y - by) : y + height + by, max(0, x - by) : x + width + by]
    around = smooth[box][inside[box] == 0]
    if level >= BURNT_OUT or not len(around):
        return 0.0
    return float(np.abs(np.percentile(around, QUARTILES) - level).max())


def _spread(values: np.ndarray) -> float:
    low, high = np.percentile(values, SPREAD)
    return float(high - low)
