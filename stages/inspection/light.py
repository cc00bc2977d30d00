"""How differently cameras expose, from the colours around points that several of them show."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from stages.frames.display import to_linear
from stages.survey.exposure import BRIGHTEST, DARKEST
from storage.rig import points_to_integer_centres

FEWEST = 12
"""Points that two cameras must share: a median of fewer is chance."""


def colors_at(picture: np.ndarray, points: np.ndarray, blur: float = 3.0) -> np.ndarray:
    """Colours [n, 3] in linear light around points [n, 2] px of [h, w, 3] uint8; 0 where nearly black or clipped."""
    soft = cv2.GaussianBlur(picture, (0, 0), blur)
    at = np.rint(points_to_integer_centres(points)).astype(int)
    sampled = soft[np.clip(at[:, 1], 0, soft.shape[0] - 1), np.clip(at[:, 0], 0, soft.shape[1] - 1)].astype(np.float64)
    exposed = ((sampled >= DARKEST) & (sampled <= BRIGHTEST)).all(axis=1)
    return np.where(exposed[:, None], to_linear(sampled), 0.0)


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
