"""What a rendering is trained to have less of: its difference from a source picture, and the slope of that."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
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
    lacking: np.ndarray | None = None  # [h, w]
    """Where the mask has nothing, but the other views' masks have somebody; None: nowhere."""

    @cached_property
    def covered(self) -> np.ndarray:
        """[h, w] bool: where somebody is."""
        return self.cover > 0

    @cached_property
    def beside(self) -> np.ndarray:
        """[h, w] float32 weight of what should be empty: 1, and 0 where the mask may lack something."""
        everywhere = np.ones(self.cover.shape, np.float32)
        return everywhere if self.lacking is None else np.where(self.lacking, np.float32(0), everywhere)

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

    w is 1 beside the person, where all should be empty (0 where the mask may lack something), and the rendered alpha,
    as a constant, on the person: what no depth map holds is a hole, and Gaussians around it that grow to fill it in one
    picture are wrong in every other.
    """
    return weighed(color, alpha, filmed, np.where(filmed.covered, alpha, filmed.beside), COVERAGE)


def weighed(color: np.ndarray, alpha: np.ndarray, filmed: Filmed, weight: np.ndarray, coverage: float) -> Loss:
    """The same with weights [h, w] float32 of your own, which have no slope."""
    box = around(filmed.covered | (alpha > 0))
    x, y, drawn, cover, inner, *moments = (
        np.ascontiguousarray(a[box]) for a in (color, filmed.color, alpha, filmed.cover, weight, *filmed.moments)
    )
    value, slope = structure(x, y, Moments(*moments), inner, STRUCTURE)
    by_color, by_alpha = np.zeros_like(color), np.zeros_like(alpha)
    flat = len(x), -1
    more, by_alpha[box] = _absolute(
        x.reshape(flat), y.reshape(flat), drawn, cover, inner, np.float32(coverage), slope.reshape(flat)
    )
    by_color[box] = slope
    return Loss(value + more, by_color, by_alpha)


@compiled
def _absolute(x, y, alpha, cover, weight, coverage, slope):  # type: ignore[no-untyped-def]
    """The absolute differences' share of the value, and their slope by alpha [h, w]; that by colours is added to
    `slope`, [h, 3 w] as x and y are, channels side by side."""
    h, n = x.shape
    by_alpha, weights = np.empty_like(alpha), np.empty(n, np.float32)
    missed, uncovered = np.zeros(n), np.zeros(n // 3)
    third, zero = np.float32((1 - STRUCTURE) / 3), np.float32(0)
    for i in range(h):
        for j in range(n // 3):
            w, off = weight[i, j], alpha[i, j] - cover[i, j]
            uncovered[j] += w * coverage * abs(off)
            by_alpha[i, j] = w * coverage * (np.float32(off > zero) - np.float32(off < zero))
            for c in range(3):
                weights[3 * j + c] = w * third
        for j in range(n):
            off = x[i, j] - y[i, j]
            missed[j] += weights[j] * abs(off)
            slope[i, j] += weights[j] * (np.float32(off > zero) - np.float32(off < zero))
    return missed.sum() + uncovered.sum(), by_alpha
