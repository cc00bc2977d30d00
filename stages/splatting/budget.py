"""Fewer Gaussians that draw nearly the same picture: what several views say twice becomes one, then neighbours on the
same surface do, where colour and normal vary least.

Which Gaussians become one is decided by `posegaussian.stages.splatting.clusters`: first by place and normal, down to
about their own size, then of what is left by place, normal and colour, down to the budget. A cluster becomes one
Gaussian by moment matching. Its weights are the Gaussians' optical mass on their surface,

    m_i = -log(1 - opacity_i) s_i0 s_i1,

because the logarithms of transmittances add where Gaussians overlap, and areas where they lie side by side. Mean: that
of m. Covariance: C = mean C_i + sum_i m_i d_i d_i^T / sum_i m_i, where d_i is the way from the mean to Gaussian i,
times sqrt(SPREAD) along the surface, so that neighbours overlap as pixels' Gaussians do, and THIN across it, where it
is the noise of depth rather than a thickness. Opacity: 1 - exp(-sum_i m_i / (s_0 s_1)), so that mass is kept. Colours
and the C_i are averaged with the weights opacity_i / (s_i0 s_i1): a view that stands near and looks at the surface
face-on makes small Gaussians of it, and has the sharpest say.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.splatting.clusters import clusters
from posegaussian.stages.splatting.definition.scene import Gaussians
from posegaussian.stages.splatting.splat_scene import MOST_OPAQUE

SPREAD = 2.5
"""Of the variance of places along the surface. Pixels' Gaussians, half a pixel wide, have three times the variance of
their pixel, which draws large clusters softer than need be; with 2 a tenth gains 0.1 dB more, but lets half as much
again through between its Gaussians."""
THIN = 0.1
"""Of the way from the mean across the surface."""
SAME = 0.85
"""Distance from the mean, in sizes of the median Gaussian, up to which Gaussians say the same."""
TURN = 1.0
"""What unit normals' distance counts against one of such a size."""
PLACE, COLOR = 0.5, 6.0
"""What, once no place is said twice, a distance of such a size and one of sRGB 0..1 count."""
SPAN = 1e60
"""Metres above which, and below whose inverse, sizes are none: products of four would leave float64."""
FAR = 1e30
"""Sizes beyond which places are not told apart, nor areas: the same reason."""


def allowed(count: int, budget: float) -> int:
    """How many Gaussians a budget leaves of `count`: a share up to 1, rounded down to at least one, or a whole number.

    Raises ValueError for a budget that is 0 or less, no number, or above 1 and not whole.
    """
    if not budget > 0 or (budget > 1 and budget != np.floor(budget)) or not np.isfinite(budget):
        raise ValueError(
            f"budget {budget:g} of Gaussians; a share above 0 and up to 1, or a whole number of them, is expected"
        )
    return min(count, int(budget) if budget > 1 else max(1, int(np.floor(budget * count))))


def within_budget(gaussians: Gaussians, budget: float) -> Gaussians:
    """At most `allowed(len(gaussians), budget)` Gaussians that draw nearly the same picture, in the same dtype and on
    the same device; where that is all of them, the same ones.

    gaussians: [N] in the world, metres, whose third axis points out of the surface. What draws nothing (opacity or a
    scale 0, anything not finite) goes first. There may be fewer left than the budget: what is said twice goes always.
    The order of the input does not matter, neither does the number of threads. Raises ValueError as `allowed` does.
    """
    most = allowed(len(gaussians), budget)
    if most >= len(gaussians):
        return gaussians
    given = _Arrays(*(getattr(gaussians, n).detach().cpu().numpy().astype(np.float64) for n in _Arrays._fields))
    left = _reduced(given.drawn().ordered(), most)
    like = gaussians.mean
    bound = torch.finfo(like.dtype)
    left = left._replace(scale=np.clip(left.scale, bound.tiny, bound.max))
    return Gaussians(*(torch.from_numpy(np.ascontiguousarray(a)).to(like.device, like.dtype) for a in left))


def _reduced(given: _Arrays, most: int) -> _Arrays:
    """At most so many; the given ones are in an order of their own."""
    if len(given.mean) <= most:
        return given
    size = float(np.median(np.sqrt(given.area)))
    features = np.hstack([given.mean / size, TURN * given.normal])
    once = clusters(_bounded(features), _weights(given, size), len(features), SAME**2)
    merged = given.merged(once)
    if len(merged.mean) <= most:
        return merged
    features = np.hstack([PLACE / size * merged.mean, TURN * merged.normal, COLOR * merged.color])
    # moments are taken of the given ones again, whose colours and sizes still have their own weights
    return given.merged(clusters(_bounded(features), _weights(merged, size), most)[once])


def _weights(given: _Arrays, size: float) -> np.ndarray:
    """[N] opaque areas in those of the median Gaussian, above 0: what they count in a picture."""
    return np.clip(given.opacity * given.area / size**2, 1 / FAR, FAR)


def _bounded(features: np.ndarray) -> np.ndarray:
    """Features within `FAR`."""
    return np.clip(features, -FAR, FAR)


class _Arrays(NamedTuple):
    """Gaussians as float64 arrays, of the shapes and units of `Gaussians`."""

    mean: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    color: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """[N] product of the standard deviations along the surface, m^2."""
        return self.scale[:, 0] * self.scale[:, 1]

    @property
    def normal(self) -> np.ndarray:
        """[N, 3] third axis."""
        return self.rotation[:, :, 2]

    def at(self, index: np.ndarray) -> _Arrays:
        """Some of them."""
        return _Arrays(*(a[index] for a in self))

    def drawn(self) -> _Arrays:
        """Those that can be seen."""
        finite = np.logical_and.reduce([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in self])
        sized = ((self.scale >= 1 / SPAN) & (self.scale <= SPAN) & (np.abs(self.mean) <= SPAN)).all(axis=1)
        return self.at(np.flatnonzero(finite & sized & (self.opacity > 0)))

    def ordered(self) -> _Arrays:
        """The same in an order that follows from their values."""
        table = np.hstack([a.reshape(len(a), int(np.prod(a.shape[1:]))) for a in self])
        return self.at(np.lexsort(table.T[::-1]))

    def merged(self, labels: np.ndarray) -> _Arrays:
        """One Gaussian for every label [N] 0..K-1, in their order; one alone stays as it is."""
        order = np.argsort(labels, kind="stable")
        own, starts = labels[order], np.flatnonzero(np.diff(labels[order], prepend=-1))
        out, alone = self.at(order[starts]), np.diff(starts, append=len(order)) == 1
        several = ~alone[own]
        joined = self.at(order[several])._joined(np.cumsum(~alone)[own[several]] - 1)
        for all_of_them, new in zip(out, joined, strict=True):
            all_of_them[~alone] = new
        return out

    def _joined(self, own: np.ndarray) -> _Arrays:
        """One Gaussian for every ascending label `own` [N], by moment matching."""
        starts = np.flatnonzero(np.diff(own, prepend=-1))
        if not len(starts):
            return self

        def total(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values, starts)

        def mean(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
            each = weights.reshape(-1, *(1,) * (values.ndim - 1))
            return total(values * each) / total(each)

        # relative to the largest and smallest of each cluster, lest sums of products leave float64
        largest, smallest = np.maximum.reduceat(self.area, starts), np.minimum.reduceat(self.area, starts)
        mass = -np.log1p(-np.minimum(self.opacity, MOST_OPAQUE)) * (self.area / largest[own])
        sharp = self.opacity * (smallest[own] / self.area)
        centre, outward = mean(self.mean, mass), _unit(mean(self.normal, mass))
        away = self.mean - centre[own]
        across = (away * outward[own]).sum(axis=1, keepdims=True) * outward[own]
        away = np.sqrt(SPREAD) * (away - across) + THIN * across
        axes = self.rotation * self.scale[:, None, :]
        covariance = mean(np.einsum("nij,nkj->nik", axes, axes), sharp) + mean(away[:, :, None] * away[:, None], mass)
        rotation, scale = _axes(covariance, outward)
        depth = total(mass) * (largest / scale[:, 0] / scale[:, 1])
        opacity = np.minimum(-np.expm1(-depth), MOST_OPAQUE)
        return _Arrays(centre, rotation, scale, opacity, mean(self.color, sharp))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """[N, 3] at unit length; one without a length stays 0."""
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return vectors / np.where(length > 0, length, 1)


def _axes(covariance: np.ndarray, outward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right-handed axes [N, 3, 3] in columns and standard deviations [N, 3] of covariances [N, 3, 3], largest first;
    the last axis points to the side of `outward` [N, 3]."""
    largest = np.abs(covariance).max(axis=(1, 2))
    variance, vectors = np.linalg.eigh(covariance / largest[:, None, None])
    # rounding may leave the smallest at 0 or below
    scale = np.sqrt(np.maximum(variance[:, ::-1], 1e-14)) * np.sqrt(largest)[:, None]
    first, last = vectors[:, :, 2], vectors[:, :, 0]
    last = np.where((last * outward).sum(axis=1, keepdims=True) < 0, -last, last)
    return np.stack([first, np.cross(last, first), last], axis=2), scale
