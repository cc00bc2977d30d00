"""What a rendering is trained to have less of: its difference from a source picture, and the slope of that."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from posegaussian.stages.refinement.steps.structure import Moments, around, structure
from posegaussian.stages.splatting.definition.scene import Camera

COVERAGE = 0.05
"""Weight of the difference in coverage beside that in colour."""
STRUCTURE = 0.2
"""Share of D-SSIM in the difference of a pixel, as published (Kerbl et al., "3D Gaussian Splatting", 2023)."""


@dataclass(frozen=True, eq=False)
class Filmed:
    """One source picture, as a rendering should look."""

    camera: Camera
    color: np.ndarray  # [h, w, 3]
    """float32, sRGB 0..1, premultiplied by the mask."""
    cover: np.ndarray  # [h, w]
    """The mask, float32, 0..1."""

    @cached_property
    def covered(self) -> np.ndarray:
        """[h, w] bool: where somebody is."""
        return self.cover > 0

    @cached_property
    def moments(self) -> Moments:
        """Of the picture."""
        return Moments.of(self.color)


class Loss(NamedTuple):
    """Of one picture."""

    value: float
    by_color: np.ndarray  # [h, w, 3]
    """Its slope by the rendered colour, premultiplied."""
    by_alpha: np.ndarray  # [h, w]
    """Its slope by the rendered alpha."""


def loss(color: np.ndarray, alpha: np.ndarray, filmed: Filmed) -> Loss:
    """Sum of w ((1 - STRUCTURE) mean_rgb |color - picture| + STRUCTURE D-SSIM + COVERAGE |alpha - mask|) over the
    pixels; color [h, w, 3] and alpha [h, w] float32 as rendered, all premultiplied.

    w is 1 beside the person, where all should be empty, and the rendered alpha, as a constant, on the person: what no
    depth map holds is a hole, and Gaussians around it that grow to fill it in one picture are wrong in every other.
    """
    return weighed(color, alpha, filmed, np.where(filmed.covered, alpha, np.float32(1)), COVERAGE)


def weighed(color: np.ndarray, alpha: np.ndarray, filmed: Filmed, weight: np.ndarray, coverage: float) -> Loss:
    """The same with weights [h, w] float32 of your own, which have no slope."""
    box = around(filmed.covered | (alpha > 0))
    x, y = np.ascontiguousarray(color[box]), np.ascontiguousarray(filmed.color[box])
    moments = Moments(*(m[box] for m in filmed.moments))
    inner = np.ascontiguousarray(weight[box])
    value, slope = structure(x, y, moments, inner, STRUCTURE)
    by_color, by_alpha = np.zeros_like(color), np.zeros_like(alpha)
    value += _absolute(
        x, y, alpha[box], filmed.cover[box], inner, np.float32(coverage), slope, by_color[box], by_alpha[box]
    )
    return Loss(value, by_color, by_alpha)


@njit(cache=True, nogil=True)
def _absolute(x, y, alpha, cover, weight, coverage, slope, by_color, by_alpha):  # type: ignore[no-untyped-def]
    """The absolute differences' share of the value; write the slopes, with that of the structure, into the last two
    arguments."""
    value = 0.0
    third = np.float32((1 - STRUCTURE) / 3)
    for i in range(x.shape[0]):
        row = np.float32(0)
        for j in range(x.shape[1]):
            w = weight[i, j]
            for c in range(3):
                off = x[i, j, c] - y[i, j, c]
                row += w * third * abs(off)
                by_color[i, j, c] = slope[i, j, c] + w * third * np.sign(off)
            off = alpha[i, j] - cover[i, j]
            row += w * coverage * abs(off)
            by_alpha[i, j] = w * coverage * np.sign(off)
        value += row
    return value
