"""How much of a camera's light lies beyond white."""

from __future__ import annotations

import numpy as np

from stages.io import Inputs

FRAMES = 5
"""Sampled frames that are looked at."""
BRIGHT = 99.9
"""Percentile of the light that is to stay below white: a lamp's core and a glint may be white."""


def light_beyond_white(picture: np.ndarray) -> np.ndarray:
    """[2]: share of the pixels with a channel above 1, and the 99.9th percentile of the largest channels, of linear light [h, w, 3].

    An 8-bit picture holds none beyond white.
    """
    if picture.dtype == np.uint8:
        return np.array([0.0, 1.0])
    brightest = picture.astype(np.float32).max(axis=2)
    return np.array([(brightest > 1).mean(), np.percentile(brightest, BRIGHT)])


def light_of_view(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """Largest of each over a few of the sampled source frames `numbers`; (0, 1) for a view that is no source."""
    if view not in inputs.views.sources or not len(numbers):
        return np.array([0.0, 1.0])
    chosen = [int(n) for n in np.unique(np.asarray(numbers)[np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), FRAMES))).astype(int)])]
    return np.max([light_beyond_white(p) for p in inputs.source("pictures").read(view, chosen)], axis=0)
