"""From maps with a Gaussian at every pixel to few that all views share: every sixth pixel of eight views or more, more
of each where there are fewer views, and as much wider as their neighbours are farther away.

Gaussians of single pixels know nothing but their own view's picture: optimised, they fit it and little else. Fewer and
wider ones, of all views together, have to agree in every picture; and a step with them takes a fraction of the time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.stages.rendering.lift import GaussianMaps

EVERY = 6.0
"""Pixels of which one keeps its Gaussian, of `VIEWS` views or more. Every ninth or twelfth of sixteen views loses 0.2
and 0.5 dB."""
VIEWS = 8
"""Fewer keep more, as many in all as so many would: tuning people of four and six cameras gain 0.0 to 0.2 dB (384 px).
Those of eight, every fourth of them: 0.03, for a quarter more time."""
LEAST = 4.0
"""Pixels of which one keeps its Gaussian of very few views. `balance` and `desk` from three cameras, of every fourth:
16.75 and 15.62 dB, SSIM .599 and .445; of two in nine SSIM is .005 less."""
WIDER = 2.0
"""Times the width of one of every `EVERY`: about what closes the gaps between neighbours of one view."""
OPACITY = 0.5
"""At the start: eight views lie on top of one another, and a gradient reaches those behind."""
STEP = (0.7548776662466927, 0.5698402909980532)
"""Of a row and a column: the R2 sequence, whose fractional parts spread evenly (Roberts, 2018)."""


def pixels_a_gaussian(views: int) -> float:
    """Of how many pixels of each of so many views one keeps its Gaussian."""
    return max(EVERY * min(views / VIEWS, 1.0), LEAST)


def thinned(maps: GaussianMaps, every: float) -> GaussianMaps:
    """The maps with opacity, the same from all sides, at one of `every` pixels that had some, and none elsewhere; other
    values as they were, but for the scale."""
    rows, columns = np.indices(np.shape(maps.depth))
    chosen = ((rows * STEP[0] + columns * STEP[1]) % 1.0 < 1.0 / every) & (np.asarray(maps.opacity)[0] > 0)
    opacity = np.repeat(np.where(chosen, OPACITY, 0.0)[None], 2, axis=0).astype(np.asarray(maps.opacity).dtype)
    wider = WIDER * (every / EVERY) ** 0.5
    return replace(maps, scale=(np.asarray(maps.scale) * wider).astype(np.asarray(maps.scale).dtype), opacity=opacity)
