"""Depth coded as disparity: what the refinement works in, and the bounds that keep it before the camera.

A pair's disparity is x0 - x1 = focal * baseline / depth + offset, px (`posegaussian.stages.geometry.rectification`).
The network may add to it whatever it likes; a disparity at or beyond its value at infinity has no depth. So every
disparity is held between those of a farthest and a nearest depth, and depth is made of it in float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch
import torch.nn.functional as F

from posegaussian.stages.geometry.rectification import RectifiedPair, Window
from posegaussian.stages.network.model.correlation import exact


@dataclass(frozen=True)
class Coding:
    """Of a batch of B directions of rectified pairs; all are float64 tensors [B]."""

    scale: torch.Tensor
    """px x metres: focal length times baseline, negative where the other view lies to the left."""
    offset: torch.Tensor
    """px: disparity at infinity, in columns of the windows that are matched."""
    near: torch.Tensor
    """metres: nearest depth that can come out."""
    far: torch.Tensor
    """metres: farthest."""

    def __post_init__(self) -> None:
        for name in ("scale", "offset", "near", "far"):
            values = getattr(self, name)
            if values.dtype != torch.float64 or values.ndim != 1 or not bool(torch.isfinite(values).all()):
                raise ValueError(
                    f"{name} of a coding is {values.dtype} {values.tolist()};"
                    " it must be finite float64 numbers, one a direction"
                )
        if not bool(((self.near > 0) & (self.near < self.far)).all()):
            raise ValueError(f"depth between {self.near.tolist()} and {self.far.tolist()} m; 0 < near < far must hold")
        if bool((self.scale == 0).any()):
            raise ValueError("a pair without a baseline along its rows has no depth: focal x baseline is 0")

    @staticmethod
    def of(pairs: Sequence[tuple[RectifiedPair, int, Window, Window]], near: float, far: float) -> Coding:
        """Of directions (pair, which of its views is the first, its window, the other view's window), between two
        depths in metres.

        A window (x0, y0, width, height) is the part of the rectified frame that is matched. Its columns start at x0, so
        the difference of both starts leaves the disparity.
        """
        signs = [1 if which == 0 else -1 for _, which, _, _ in pairs]
        scale = [s * p.focal * p.baseline for s, (p, _, _, _) in zip(signs, pairs, strict=True)]
        offset = [s * p.offset - (first[0] - other[0]) for s, (p, _, first, other) in zip(signs, pairs, strict=True)]
        return Coding(
            *(torch.tensor(v, dtype=torch.float64) for v in (scale, offset, [near] * len(pairs), [far] * len(pairs)))
        )

    def only(self, direction: int) -> Coding:
        """That of one direction."""
        return Coding(*(getattr(self, f.name)[direction : direction + 1] for f in fields(self)))

    def bounds(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Smallest and largest disparity [B], px, float64."""
        ends = torch.stack([self.scale / self.near + self.offset, self.scale / self.far + self.offset])
        return ends.amin(0), ends.amax(0)

    def limit(self, disparity: torch.Tensor, stride: int = 1) -> torch.Tensor:
        """Disparities [B, 1, h, w], in cells of `stride` px, held within the bounds.

        The gradient of a value beyond a bound passes only where it leads back: a clamp alone would never let it return.
        """
        low, high = (b.to(disparity.device, disparity.dtype)[:, None, None, None] / stride for b in self.bounds())
        return _Limit.apply(disparity, low, high)

    def depth(self, disparity: torch.Tensor) -> torch.Tensor:
        """Disparity [B, 1, h, w], px -> rectified depth, metres, never less than `near` nor more than `far`; at least
        float32.

        A disparity beyond infinity is as far as can be. Not checked: that disparities are numbers; NaN stays NaN.
        """
        scale, offset, near, far = (
            v.to(disparity.device)[:, None, None, None] for v in (self.scale, self.offset, self.near, self.far)
        )
        inverse = (disparity.double() - offset) / scale
        depth = 1 / torch.minimum(torch.maximum(inverse, 1 / far), 1 / near)
        return depth.to(exact(disparity.dtype))

    def disparity(self, depth: torch.Tensor) -> torch.Tensor:
        """Rectified depth [B, 1, h, w], metres -> disparity, px, within the bounds; NaN where there is no surface
        (not finite, or not above 0)."""
        scale, offset, near, far = (
            v.to(depth.device)[:, None, None, None] for v in (self.scale, self.offset, self.near, self.far)
        )
        known = torch.isfinite(depth) & (depth > 0)
        z = torch.minimum(torch.maximum(torch.where(known, depth.double(), near), near), far)
        return torch.where(known, scale / z + offset, torch.nan).to(exact(depth.dtype))

    def seeded(self, disparity: torch.Tensor, stride: int) -> torch.Tensor:
        """A start [B, 1, ceil(h / stride), ceil(w / stride)], cells, of a disparity [B, 1, h, w], px, that is NaN where
        unknown.

        A cell is the mean of its known pixels; one without any takes the picture's mean, and in a picture without any
        all take the middle of the bounds. The result is finite and within the bounds.
        """
        known = torch.isfinite(disparity)
        value = torch.where(known, disparity, 0).to(exact(disparity.dtype))
        weight = known.to(value.dtype)
        count = weight.sum((2, 3), keepdim=True)
        low, high = (b.to(value.device, value.dtype)[:, None, None, None] for b in self.bounds())
        everywhere = torch.where(count > 0, value.sum((2, 3), keepdim=True) / count.clamp(min=1), (low + high) / 2)
        part = F.avg_pool2d(weight, stride, ceil_mode=True)
        cells = F.avg_pool2d(torch.where(known, value - everywhere, 0), stride, ceil_mode=True) / torch.where(
            part > 0, part, 1
        )
        return self.limit((cells + everywhere) / stride, stride)


class _Limit(torch.autograd.Function):
    """A clamp whose gradient passes beyond a bound where a step against it leads back inside."""

    @staticmethod
    def forward(ctx: Any, value: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(value < low, value > high)
        return torch.minimum(torch.maximum(value, low), high)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        below, above = ctx.saved_tensors
        (gradient,) = gradients
        lost = (below & (gradient > 0)) | (above & (gradient < 0))
        return torch.where(lost, 0, gradient), None, None
