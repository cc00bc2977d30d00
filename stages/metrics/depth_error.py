"""Error of a depth map, in pixels of the disparity that a stereo network would have had to find."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from posegaussian.stages.geometry.pairs import angle_at
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

MISSING = 16.0
"""Px counted for a pixel without depth."""


class DepthError(NamedTuple):
    """Mean over the true surface of one picture."""

    epe: float
    """End-point error: mean disparity error, px."""
    one_pixel: float
    """Share of the pixels whose error is below 1 px."""
    pixels: int
    """Pixels measured."""


def nearest_pair(rig: Rig, view: int, sources: Sequence[int]) -> RectifiedPair:
    """The rectified pair of `view` with the source view at the smallest angle at the subject, whatever its verdict.

    Raises ValueError when there is no other source view, or no rectification of the nearest.
    """
    others = [v for v in sources if v != view]
    if not others:
        raise ValueError(f"view {rig.names[view]} is the only source view; a disparity needs a second one")
    subject, centres = look_at_point(rig.subset(sources)), rig.centres
    return rectify(
        rig, view, min(others, key=lambda v: (round(angle_at(subject, centres[view], centres[v]), 1), v)), subject
    )


def disparity_error(depth: np.ndarray, truth: np.ndarray, pair: RectifiedPair) -> np.ndarray:
    """[h, w] f B abs(1/z - 1/z_true), px: both depths [h, w] are those of the pair's first view, z is its rectified
    depth.

    16 px where `depth` is 0; 0 where `truth` is 0.
    """
    _, ratio = pair.rectified_pixels(0, pixel_centres(depth.shape[::-1]))
    known, given = truth > 0, depth > 0
    apart = np.abs(1 / np.where(given, depth, 1).astype(np.float64) - 1 / np.where(known, truth, 1)) / ratio
    return np.where(known, np.where(given, pair.focal * abs(pair.baseline) * apart, MISSING), 0.0)


def depth_error(
    depth: np.ndarray, truth: np.ndarray, mask: np.ndarray, rig: Rig, view: int, sources: Sequence[int]
) -> DepthError | None:
    """EPE and 1 px share of one source view over all pixels of the truth mask [h, w] uint8 > 127; None where there are
    none.

    `depth` and `truth` [h, w] are metres along the optical axis, 0 = none. Mask pixels whose centre misses the true
    surface have no true depth and are left out. Raises ValueError for depth that is negative or not finite.
    """
    if not (np.isfinite(depth) & (depth >= 0)).all():
        raise ValueError(f"depth of view {rig.names[view]} holds values that are negative or not finite")
    measured = foreground(mask) & (truth > 0)
    if not measured.any():
        return None
    error = disparity_error(depth, truth, nearest_pair(rig, view, sources))[measured]
    return DepthError(float(error.mean()), float((error < 1).mean()), int(measured.sum()))
