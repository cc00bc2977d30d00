"""How noisy a camera's pictures are."""

from __future__ import annotations

import cv2
import numpy as np

from stages.frames.display import to_display
from stages.io import Inputs
from stages.survey.patches import BRIGHTEST, DARKEST

LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Zero on planes; of noise of standard deviation s it makes one of 6 s (Immerkaer, "Fast noise variance estimation", 1996)."""
FRAMES = 5
"""Sampled frames that are looked at."""


def noise_level(picture: np.ndarray) -> float:
    """Standard deviation of a picture's noise, 1/255 sRGB, mean of the channels; [h, w, 3] uint8.

    The median of the Laplacian's deviation instead of Immerkaer's mean, so that edges do not count, over pixels that are
    neither nearly black nor nearly white, where noise is cut off; 0 where there are none. Fine texture counts as noise.
    """
    response = np.abs(cv2.filter2D(picture.astype(np.float32), -1, LAPLACIAN))[1:-1, 1:-1]
    inner = picture[1:-1, 1:-1]
    middling = ((inner >= DARKEST) & (inner <= BRIGHTEST)).all(axis=2)
    return float(np.median(response[middling], axis=0).mean() / (6 * 0.6745)) if middling.any() else 0.0


def noise_of_view(inputs: Inputs, view: int, numbers: np.ndarray) -> float:
    """Median over a few of the sampled source frames `numbers` of `noise_level`; 0 for a view that is no source."""
    if view not in inputs.views.sources or not len(numbers):
        return 0.0
    chosen = [int(n) for n in np.unique(np.asarray(numbers)[np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), FRAMES))).astype(int)])]
    return float(np.median([noise_level(to_display(p)) for p in inputs.source("pictures").read(view, chosen)]))
