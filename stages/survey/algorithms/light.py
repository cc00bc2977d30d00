"""How much of a camera's light lies beyond white, and whether its pictures show anything at all."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.masks import foreground

BRIGHT = 99.9
"""Percentile of the light that is to stay below white: a lamp's core and a glint may be white."""
SMOOTHED = 9
"""Px over which a picture is averaged before its contrast is taken, so that noise counts as none."""
SPREAD = (2, 98)
"""Percentiles between which contrast is taken."""


def light_beyond_white(picture: np.ndarray) -> np.ndarray:
    """[2]: share of the pixels with a channel above 1, and the 99.9th percentile of the largest channels, of linear
    light [h, w, 3].

    An 8-bit picture holds none beyond white.
    """
    if picture.dtype == np.uint8:
        return np.array([0.0, 1.0])
    brightest = picture.astype(np.float32).max(axis=2)
    return np.array([(brightest > 1).mean(), np.percentile(brightest, BRIGHT)])


def contrast(picture: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """By how much a picture [h, w, 3] uint8 varies in brightness, 1/255 sRGB: between its second and 98th percentile,
    of averages over a few pixels; inside the mask [h, w] where there is one of its size, None where that is empty.

    A lens cap, a lamp in the lens, a stuck grey: next to nothing.
    """
    smooth = cv2.blur(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), (SMOOTHED, SMOOTHED))
    if mask is None or mask.shape != smooth.shape:
        return _spread(smooth)
    inside = foreground(mask).astype(np.uint8)
    # Averages at the rim hold what lies behind; a mask that is thinner than that keeps its rim.
    inner = cv2.erode(inside, np.ones((SMOOTHED, SMOOTHED), np.uint8))
    seen = smooth[(inner if inner.any() else inside) > 0]
    return _spread(seen) if len(seen) else None


def _spread(values: np.ndarray) -> float:
    low, high = np.percentile(values, SPREAD)
    return float(high - low)
