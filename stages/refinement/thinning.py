"""From maps with a Gaussian at every pixel to few that all views share: one of six pixels of eight views or more, more
of each where there are fewer views; many where the picture has detail and few where it is plain, as much wider as their
neighbours are farther away.

Gaussians of single pixels know nothing but their own view's picture: optimised, they fit it and little else. Fewer and
wider ones, of all views together, have to agree in every picture; and a step with them takes a fraction of the time.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from posegaussian.stages.refinement.params import EVERY
from posegaussian.stages.rendering.lift import GaussianMaps

WIDER = 2.0
"""Times the width of one of every `EVERY`: about what closes the gaps between neighbours of one view."""
OPACITY = 0.5
"""At the start: eight views lie on top of one another, and a gradient reaches those behind."""
STEP = (0.7548776662466927, 0.5698402909980532)
"""Of a row and a column: the R2 sequence, whose fractional parts spread evenly (Roberts, 2018)."""
PLAIN = 4.0
"""Of 255 a pixel: Gaussians stand as densely as this and the slope of the brightness together. Eight tuning people (384
px) gain 0.08 dB over an even spread, -0.04 to +0.20; with a tenth of the pixels, 0.13, -0.05 to +0.28."""
AROUND = 2.0
"""Px, standard deviation of the surroundings over which slopes are averaged."""
DENSEST, SPARSEST = 2.0, 40.0
"""Pixels of which one keeps its Gaussian where the picture has most detail, and where it has least."""
HALVINGS = 40
"""Of the bounds between which the density is sought."""


def thinned(maps: GaussianMaps, every: float) -> GaussianMaps:
    """The maps with opacity, the same from all sides, at one of `every` pixels that had some, and none elsewhere; other
    values as they were, but for the scale."""
    rows, columns = np.indices(np.shape(maps.depth))
    share = shares(np.asarray(maps.color), np.asarray(maps.opacity)[0] > 0, every)
    chosen = (rows * STEP[0] + columns * STEP[1]) % 1.0 < share
    opacity = np.repeat(np.where(chosen, OPACITY, 0.0)[None], 2, axis=0).astype(np.asarray(maps.opacity).dtype)
    wider = WIDER * np.sqrt(1 / (EVERY * np.where(chosen, share, 1 / EVERY)))
    return replace(maps, scale=(np.asarray(maps.scale) * wider).astype(np.asarray(maps.scale).dtype), opacity=opacity)


def shares(color: np.ndarray, some: np.ndarray, every: float) -> np.ndarray:
    """[h, w] share of the Gaussians that are kept about each pixel, 0 where there are none: one of `every` on the mean
    over `some` [h, w] bool, and proportional to the picture's detail within `DENSEST` and `SPARSEST`."""
    wanted, found = PLAIN + detail(color, some)[some].astype(np.float64), np.zeros(some.shape)
    least, most = 0.0, 1 / (DENSEST * PLAIN)
    for _ in range(HALVINGS if len(wanted) else 0):
        middle = (least + most) / 2
        enough = _within(middle * wanted).mean() >= 1 / every
        least, most = (least, middle) if enough else (middle, most)
    found[some] = _within(most * wanted)
    return found


def _within(share: np.ndarray) -> np.ndarray:
    return np.clip(share, 1 / SPARSEST, 1 / DENSEST)


def detail(color: np.ndarray, some: np.ndarray) -> np.ndarray:
    """[h, w] slope of the brightness of a picture [h, w, 3] of 0..255, a pixel, on the mean of the surroundings. Only
    within `some` [h, w] bool: across its rim the picture is of something else."""
    bright = color.mean(axis=2, dtype=np.float32)
    inner = cv2.erode(some.astype(np.float32), np.ones((3, 3), np.uint8), borderValue=0)
    down, across = (cv2.Scharr(bright, cv2.CV_32F, *order) / 32 for order in ((0, 1), (1, 0)))
    summed, weight = (cv2.GaussianBlur(a, (0, 0), AROUND) for a in (inner * np.hypot(down, across), inner))
    return np.where(weight > 1e-3, summed / np.maximum(weight, 1e-3), np.float32(0))
