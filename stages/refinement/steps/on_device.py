"""Steps of Gaussians on a device, where what is optimised stays from the first to the last of them.

The same as `HostWalk` takes, by the renderer's kernels and those of `device_lifting` and `device_loss`: what is
optimised lies in one tensor. Only the mean over steps is brought to the host, to be judged and kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
import triton

from posegaussian.stages.refinement.steps import device_lifting
from posegaussian.stages.refinement.steps.attributes import CHANNELS, SharedGaussians, ViewGaussians
from posegaussian.stages.refinement.steps.device_lifting import BLOCK
from posegaussian.stages.refinement.steps.device_loss import DevicePicture, device_loss
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.steps.optimise import (
    MEAN,
    NEEDLESS,
    NEWEST,
    SQUARE,
    Walk,
    fitting_rates,
    rates_of,
)
from posegaussian.stages.splatting.definition.scene import Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize

ROWS = list(CHANNELS.values())
"""Of the offsets [14, N], attribute by attribute."""


class DeviceGaussians:
    """What `SharedGaussians` holds but for the offsets, on a device."""

    def __init__(self, shared: SharedGaussians, device: torch.device) -> None:
        rays = shared.rays
        view = np.repeat(np.arange(len(rays.poses), dtype=np.int32), np.diff(rays.starts))
        base = np.concatenate([shared.base[name] for name in CHANNELS if name in shared.base])
        given = base, shared.footprint, shared.twist, np.stack([rays.x, rays.y]), view, rays.poses, rays.pitch
        self.held = [torch.from_numpy(np.ascontiguousarray(a)).to(device) for a in given]
        self.grid = (triton.cdiv(len(shared), BLOCK),)

    def moved(self, offsets: torch.Tensor) -> Gaussians:
        """The Gaussians in the world, the same from all sides; each a leaf, whose gradient `slopes` carries on."""
        n = offsets.shape[1]
        mean, rotation, scale, opacity, color = (offsets.new_empty((n, *s)) for s in ((3,), (3, 3), (3,), (), (3,)))
        device_lifting.lifted[self.grid](offsets, *self.held, mean, rotation, scale, opacity, color, n)
        return Gaussians(*(t.requires_grad_() for t in (mean, rotation, scale, opacity, color)))

    def slopes(self, offsets: torch.Tensor, gaussians: Gaussians) -> torch.Tensor:
        """[14, N] what the gradients of `gaussians`, made of these offsets, are by the offsets."""
        out = torch.empty_like(offsets)
        by = [torch.zeros_like(t) if t.grad is None else t.grad.contiguous() for t in vars(gaussians).values()]
        device_lifting.slopes_of[self.grid](offsets, *self.held, *by, out, offsets.shape[1])
        return out


class DeviceWalk(Walk):
    """On a device with Triton, which gives equal bits in every run."""

    def __init__(
        self,
        gaussians: Mapping[int, ViewGaussians],
        filmed: Mapping[int, Filmed],
        order: Sequence[int],
        device: torch.device,
    ) -> None:
        super().__init__(gaussians, filmed, order)
        self.there = DeviceGaussians(self.gaussians, device)
        self.seen = [DevicePicture.of(p, device) for p in self.pictures]
        rates = rates_of(len(self.pictures), fitting_rates(self.pictures))
        self.rates = torch.tensor([rates[name] for name, count in CHANNELS.items() for _ in range(count)]).to(device)
        bounds = zip(*(self.gaussians.bounds[name] for name in CHANNELS), strict=True)
        self.lower, self.upper = (self._rows(side).to(device) for side in bounds)
        self.offsets, self.mean, self.square, self.average = (torch.zeros_like(self.lower) for _ in range(4))
        self.moves = 0
        self.not_finite = torch.zeros((), dtype=torch.int32, device=device)

    def _rows(self, values: Sequence[np.ndarray | float]) -> torch.Tensor:
        """[14, N] of a value or [C, N] of each attribute."""
        shapes = [a.shape for a in self.gaussians.offsets.values()]
        parts = [np.broadcast_to(v, shape) for v, shape in zip(values, shapes, strict=True)]
        return torch.from_numpy(np.concatenate(parts).astype(np.float32))

    @property
    def masked(self) -> int:
        """Waits for the steps taken so far."""
        return int(self.not_finite)

    @property
    def reached(self) -> SharedGaussians:
        """Brought to the CPU."""
        parts = self.average.cpu().split(ROWS)
        return self.gaussians.with_offsets({name: a.numpy() for name, a in zip(CHANNELS, parts, strict=True)})

    def _learn(self, picture: int, slower: float) -> None:
        seen, gaussians = self.seen[picture], self.there.moved(self.offsets)
        drawn = rasterize(gaussians, [seen.camera])
        by_color, by_alpha = device_loss(drawn.color[0].detach(), drawn.alpha[0].detach(), seen)
        torch.autograd.backward(
            [drawn.color, drawn.alpha, gaussians.opacity],
            [by_color[None], by_alpha[None], torch.full_like(gaussians.opacity, NEEDLESS)],
        )
        self._move(self.there.slopes(self.offsets, gaussians), slower)

    def _move(self, slopes: torch.Tensor, slower: float) -> None:
        """As `HostWalk`'s Adam does."""
        self.moves += 1
        n, total = slopes.shape[1], slopes.numel()
        shorter, unbiased = 1 / (slower * (1 - MEAN**self.moves)), 1 / (1 - SQUARE**self.moves)
        device_lifting.adam[(triton.cdiv(total, BLOCK),)](
            self.offsets, slopes, self.mean, self.square, self.rates, self.lower, self.upper, self.not_finite,
            shorter, unbiased, 1 - MEAN, 1 - SQUARE, n, total,
        )  # fmt: skip

    def _remember(self) -> None:
        self.average.lerp_(self.offsets, NEWEST)
