"""From maps with a Gaussian at every pixel to few that all views share: every sixth pixel of eight views or more, more
of each where there are fewer views, and as much wider as their neighbours are farther away.

Gaussians of single pixels know nothing but their own view's picture: optimised, they fit it and little else. Fewer and
wider ones, of all views together, have to agree in every picture; and a step with them takes a fraction of the time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.stages.refinement.params import EVERY
from posegaussian.stages.rendering.lift import GaussianMaps

WIDER = 2.0
"""Times the width of one of every `EVERY`: about what closes the gaps between neighbours of one view."""
OPACITY = 0.5
"""At the start: eight views lie on top of one another, and a gradient reaches those behind."""
STEP = (0.7548776662466927, 0.5698402909980532)
"""Of a row and a column: the R2 sequence, whose fractional parts spread evenly (Roberts, 2018)."""


def thinned(maps: GaussianMaps, every: float) -> GaussianMaps:
    """The maps with opacity, the same from all sides, at one of `every` pixels that had some, and none elsewhere; other
    values as they were, but for the scale."""
    rows, columns = np.indices(np.shape(maps.depth))
    chosen = ((rows * STEP[0] + columns * STEP[1]) % 1.0 < 1.0 / every) & (np.asarray(maps.opacity)[0] > 0)
    opacity = np.repeat(np.where(chosen, OPACITY, 0.0)[None], 2, axis=0).astype(np.asarray(maps.opacity).dtype)
    wider = WIDER * (every / EVERY) ** 0.5
    return replace(maps, scale=(np.asarray(maps.scale) * wider).astype(np.asarray(maps.scale).dtype), opacity=opacity)
