"""How much of a camera's light lies beyond white."""

from __future__ import annotations

import numpy as np

BRIGHT = 99.9
"""Percentile of the light that is to stay below white: a lamp's core and a glint may be white."""


def light_beyond_white(picture: np.ndarray) -> np.ndarray:
    """[2]: share of the pixels with a channel above 1, and the 99.9th percentile of the largest channels, of linear
    light [h, w, 3].

    An 8-bit picture holds none beyond white.
    """
    if picture.dtype == np.uint8:
        return np.array([0.0, 1.0])
    brightest = picture.astype(np.float32).max(axis=2)
    return np.array([(brightest > 1).mean(), np.percentile(brightest, BRIGHT)])
