"""How differently cameras expose, from the colours around points that several of them show."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

FEWEST = 12
"""Points that two cameras must share: a median of fewer is chance."""


def stops_apart(differences: Mapping[tuple[int, int], np.ndarray], cameras: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Stops [V, 3] by which each camera is brighter than the middle one, and their standard errors [V]; None where nothing can be compared.

    differences: for pairs of cameras, [n, 3] stops by which the first is brighter at shared points. Least squares over the pairs'
    medians; a camera without a pair has error infinity.
    """
    known = {p: d for p, d in differences.items() if len(d) >= FEWEST}
    if not known:
        return None
    rows, right, error, linked = [], [], [], np.zeros(cameras, bool)
    for (a, b), d in known.items():
        row = np.zeros(cameras)
        row[a], row[b] = 1.0, -1.0
        middle = np.median(d, axis=0)
        rows.append(row)
        right.append(middle)
        # Of a median: 1.25 times a mean's; 1.4826 MAD is a normal's standard deviation.
        error.append(1.25 * 1.4826 * float(np.median(np.abs(d - middle))) / np.sqrt(len(d)) + 0.02)
        linked[[a, b]] = True
    weight = 1 / np.array(error)
    inverse = np.linalg.pinv(np.array(rows) * weight[:, None])
    off = inverse @ (np.array(right) * weight[:, None])
    off -= np.median(off[linked], axis=0)
    return np.where(linked[:, None], off, 0.0), np.where(linked, np.sqrt((inverse**2).sum(axis=1)), np.inf)
