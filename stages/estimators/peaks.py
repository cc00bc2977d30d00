"""Peaks of heatmaps and of SimCC bins, to a fraction of a cell.

Both take the cell with the largest value and one Newton step on the logarithm of the values, whose derivatives are
central
differences: exact for a Gaussian of any width and orientation (DARK, Zhang et al., https://arxiv.org/abs/1910.06278).
"""

from __future__ import annotations

import numpy as np

LEAST = 1e-10
"""Values below it count as it, as their logarithm means nothing."""


def heatmap_peaks(maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [J, 2] (column, row) in cells and values [J] of the peaks of maps [J, h, w] of positive weights.

    A peak on the rim, or one whose logarithm is not concave, stays at its cell's index.
    """
    j, h, w = maps.shape
    flat = maps.reshape(j, -1).argmax(1)
    places = np.stack([flat % w, flat // w], axis=1).astype(np.float64)
    logs = np.log(np.maximum(maps.astype(np.float64), LEAST))
    for k, (x, y) in enumerate(places.astype(int)):
        if 0 < x < w - 1 and 0 < y < h - 1:
            places[k] += _step(logs[k, y - 1 : y + 2, x - 1 : x + 2])
    return places, maps.reshape(j, -1).max(1)


def bin_peaks(logs: np.ndarray) -> np.ndarray:
    """[J] places in bins of the peaks of logarithms of weights [J, n];
    one at the end, or on a plateau, stays at its index."""
    n = logs.shape[1]
    at = logs.argmax(1)
    inner = np.clip(at, 1, n - 2)
    before, here, after = (np.take_along_axis(logs.astype(np.float64), inner[:, None] + d, 1)[:, 0] for d in (-1, 0, 1))
    curvature = 2 * here - before - after
    step = np.divide(after - before, 2 * curvature, out=np.zeros(len(at)), where=(curvature > 0) & (at == inner))
    return at + np.clip(step, -0.5, 0.5)


def _step(logs: np.ndarray) -> np.ndarray:
    """[2] (right, down) from the middle of 3 x 3 logarithms to the top of the paraboloid through them, two cells at
    most each way."""
    gradient = np.array([logs[1, 2] - logs[1, 0], logs[2, 1] - logs[0, 1]]) / 2
    cross = (logs[2, 2] - logs[2, 0] - logs[0, 2] + logs[0, 0]) / 4
    hessian = np.array(
        [[logs[1, 2] - 2 * logs[1, 1] + logs[1, 0], cross], [cross, logs[2, 1] - 2 * logs[1, 1] + logs[0, 1]]]
    )
    if hessian[0, 0] >= 0 or np.linalg.det(hessian) <= 0:
        return np.zeros(2)
    return np.clip(np.linalg.solve(hessian, -gradient), -2, 2)
