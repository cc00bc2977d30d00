"""From maps with a Gaussian at every pixel to few that all views share: every sixth pixel, twice as wide.

Gaussians of single pixels know nothing but their own view's picture: optimised, they fit it and little else. Fewer and
wider ones, of all views together, have to agree in every picture; and a step with them takes a fraction of the time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.stages.rendering.lift import GaussianMaps

EVERY = 6
"""Pixels of which one keeps its Gaussian."""
WIDER = 2.0
"""Times its width: about what closes the gaps between neighbours of one view."""
OPACITY = 0.5
"""At the start: eight views lie on top of one another, and a gradient reaches those behind."""
STEP = (0.7548776662466927, 0.5698402909980532)
"""Of a row and a column: the R2 sequence, whose fractional parts spread evenly (Roberts, 2018)."""


def thinned(maps: GaussianMaps) -> GaussianMaps:
    """The maps with opacity, the same from all sides, at every sixth pixel that had some, and none elsewhere; other
    values as they were."""
    rows, columns = np.indices(np.shape(maps.depth))
    chosen = ((rows * STEP[0] + columns * STEP[1]) % 1.0 < 1.0 / EVERY) & (np.asarray(maps.opacity)[0] > 0)
    opacity = np.repeat(np.where(chosen, OPACITY, 0.0)[None], 2, axis=0).astype(np.asarray(maps.opacity).dtype)
    return replace(maps, scale=(np.asarray(maps.scale) * WIDER).astype(np.asarray(maps.scale).dtype), opacity=opacity)
