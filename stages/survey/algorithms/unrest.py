"""How much a camera's pictures change from one frame to the next where nothing moves."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.survey.algorithms.patches import BRIGHTEST, DARKEST

QUIET, OF_QUIET = 0.25, 0.404
"""Share of the pixels that surely stand still, and what it is of the variance: the quantile of a mean of three squared
normal differences."""


def unrest(before: np.ndarray, after: np.ndarray) -> float:
    """Standard deviation of the noise of two pictures [h, w, 3] uint8 of one camera that follow each other, 1/255 sRGB.

    From the quarter of the pixels that changed least, of those that are neither nearly black nor nearly white, where
    noise is cut off; 0 where there are none. Too large where more than half of the picture moves.
    """
    middling = ((before >= DARKEST) & (before <= BRIGHTEST) & (after >= DARKEST) & (after <= BRIGHTEST)).all(axis=2)
    if not middling.any():
        return 0.0
    apart = ((before[middling].astype(np.float32) - after[middling]) ** 2).mean(axis=1)
    return float(np.sqrt(np.quantile(apart, QUIET) / (2 * OF_QUIET)))
