"""Blur by discs whose radius differs from pixel to pixel."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled


@compiled
def spread(light: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """[h, w, 3] float32: each pixel is the mean of the neighbours whose discs reach it, each by its disc's density.

    light [h, w, 3] linear; radius [h, w] px of each pixel's disc, at most 24 px; discs have edges one pixel soft.
    """
    h, w = radius.shape
    out = np.zeros_like(light)
    largest = 0.0
    for i in range(h):
        for j in range(w):
            largest = max(largest, radius[i, j])
    n = math.ceil(min(largest, 24.0) + 0.5)
    for i in range(h):
        for j in range(w):
            total, r, g, b = 0.0, 0.0, 0.0, 0.0
            for a in range(max(0, i - n), min(h, i + n + 1)):
                for c in range(max(0, j - n), min(w, j + n + 1)):
                    size = min(radius[a, c], 24.0)
                    away = math.sqrt((a - i) * (a - i) + (c - j) * (c - j))
                    share = min(1.0, max(0.0, size + 0.5 - away))
                    if a == i and c == j:
                        share = 1.0
                    if share > 0.0:
                        share /= 1.0 + math.pi * size * size
                        total += share
                        r += share * light[a, c, 0]
                        g += share * light[a, c, 1]
                        b += share * light[a, c, 2]
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = r / total, g / total, b / total
    return out
