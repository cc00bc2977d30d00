"""One step of the recurrent refinement: what is known about the match goes in, a change of the disparity comes out.

After RAFT-Stereo (Lipson et al. 2021). Disparities, the head that changes them and the convex up-sampling are at least
float32 even under autocast; the convolutions of the recurrence are in whatever autocast chooses.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import nn

from posegaussian.stages.network.model.correlation import exact
from posegaussian.stages.network.model.layout import stacked

MASK_GAIN = 0.25
"""Of the weights' logits, as in RAFT: the head learns as fast as the others."""


def pointwise(inputs: int, outputs: int) -> nn.Conv2d:
    """A 1 x 1 convolution that gives the same bytes on one thread and on several.

    torch computes 1 x 1 convolutions by other code on one thread than on several, unless they are dilated or strided.
    Dilation does nothing to a single tap but choose the code.
    """
    return nn.Conv2d(inputs, outputs, 1, dilation=2)


def ending(head: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    """What a head says: its last layer at least in float32, those before it in whatever autocast chooses."""
    hidden = head[:-1](x)
    with torch.autocast(x.device.type, enabled=False):
        return head[-1](hidden.to(exact(hidden.dtype)))


class MotionEncoder(nn.Module):
    """Correlation [B, K, h, w] and how far the disparity has moved from its start [B, 1, h, w], cells -> [B, width, h,
    w].

    The move and not the disparity: it says the same whatever windows are matched, and whatever the offset of the pair.
    """

    def __init__(self, correlation_channels: int, width: int) -> None:
        super().__init__()
        half = max(width // 2, 1)
        self.correlation = nn.Sequential(
            pointwise(correlation_channels, width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, half, 3, padding=1),
            nn.ReLU(inplace=True),
        )
        self.moved = nn.Sequential(
            nn.Conv2d(1, half, 7, padding=3),
            nn.ReLU(inplace=True),
            nn.Conv2d(half, half, 3, padding=1),
            nn.ReLU(inplace=True),
        )
        self.both = nn.Conv2d(2 * half, width - 1, 3, padding=1)

    def forward(self, correlation: torch.Tensor, moved: torch.Tensor) -> torch.Tensor:
        """What is seen and how far it has moved, in one map; the move is its last channel."""
        seen = stacked(self.correlation(correlation), self.moved(moved))
        return stacked(torch.relu_(self.both(seen)), moved)


class ConvGRU(nn.Module):
    """A gated recurrent unit of 3 x 3 convolutions (Cho et al. 2014);
    the context's part is computed once for all steps."""

    def __init__(self, hidden: int, inputs: int) -> None:
        super().__init__()
        self.gates = nn.Conv2d(hidden + inputs, 2 * hidden, 3, padding=1)
        self.candidate = nn.Conv2d(hidden + inputs, hidden, 3, padding=1)

    def forward(self, state: torch.Tensor, inputs: torch.Tensor, context: torch.Tensor) -> torch.Tensor:
        """State [B, hidden, h, w], inputs [B, inputs, h, w] and the context's part of update, reset and candidate
        [B, 3 hidden, h, w] -> state."""
        hidden = state.shape[1]
        both, new = context[:, : 2 * hidden], context[:, 2 * hidden :]
        update, reset = torch.sigmoid_(self.gates(stacked(state, inputs)).add_(both)).chunk(2, dim=1)
        candidate = torch.tanh_(self.candidate(stacked(reset * state, inputs)).add_(new))
        return torch.lerp(state, candidate, update)


class Update(nn.Module):
    """Motion encoder, recurrence, and the heads that read its state.

    `factor`: pixels a cell, of the up-sampling. The first step of an untrained network leaves the disparity where it
    is: the last layer of the delta head starts at zero, and so do the logits of the up-sampling.
    """

    def __init__(self, correlation_channels: int, hidden: int, factor: int) -> None:
        super().__init__()
        self.factor = factor
        motion = hidden // 2
        self.motion = MotionEncoder(correlation_channels, motion)
        self.recurrence = ConvGRU(hidden, motion)
        self.delta = nn.Sequential(
            nn.Conv2d(hidden, hidden, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(hidden, 1, 3, padding=1)
        )
        self.mask = nn.Sequential(
            nn.Conv2d(hidden, hidden, 3, padding=1), nn.ReLU(inplace=True), pointwise(hidden, 9 * factor**2)
        )
        for head in (self.delta, self.mask):
            for last in list(head.parameters())[-2:]:
                nn.init.zeros_(last)

    def forward(
        self, state: torch.Tensor, context: torch.Tensor, correlation: torch.Tensor, moved: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The next state, and the change of the disparity [B, 1, h, w], cells, at least float32."""
        state = self.recurrence(state, self.motion(correlation, moved), context)
        return state, ending(self.delta, state)

    def weights(self, state: torch.Tensor) -> torch.Tensor:
        """Weights [B, h, w, 9, factor^2] of the up-sampling that belongs to a state."""
        return convex_weights(ending(self.mask, state), self.factor, MASK_GAIN)


def convex_weights(logits: torch.Tensor, factor: int, gain: float = 1.0) -> torch.Tensor:
    """Logits [B, 9 factor^2, h, w], times `gain`, -> weights [B, h, w, 9, factor^2] of a cell's 3 x 3 neighbours at
    each of its pixels, row by row.

    They are at least 0 and sum to 1. Logits of 0 give the quadratic B-spline's weights (1/2 - s)^2 / 2, 3/4 - s^2 and
    (1/2 + s)^2 / 2 at a pixel s cells from the centre, whose mean position is the pixel: a plane stays a plane before
    anything is learned.
    """
    dtype = exact(logits.dtype)
    s = (torch.arange(factor, dtype=dtype, device=logits.device) - (factor - 1) / 2) / factor
    line = torch.stack([(0.5 - s) ** 2 / 2, 0.75 - s**2, (0.5 + s) ** 2 / 2])
    start = (line[:, None, :, None] * line[None, :, None, :]).reshape(9, factor**2).log()
    return torch.softmax(
        torch.add(start, logits.to(dtype).permute(0, 2, 3, 1).unflatten(3, (9, factor**2)), alpha=gain), dim=3
    )


def upsample(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Values [B, C, h, w] of cells -> [B, C, factor h, factor w], convex combinations of 3 x 3 cells, at least float32.

    Beyond the rim the rim's own value stands, so that nothing is pulled to 0. Disparities in cells are multiplied by
    the factor by the caller.
    """
    batch, channels, height, width = values.shape
    factor = math.isqrt(weights.shape[-1])
    with torch.autocast(values.device.type, enabled=False):
        padded = F.pad(values.to(weights.dtype), (1, 1, 1, 1), mode="replicate")
        around = torch.stack(
            [padded[:, :, y : y + height, x : x + width] for y in range(3) for x in range(3)], dim=-1
        ).permute(0, 2, 3, 1, 4)
        fine = (around @ weights).reshape(batch, height, width, channels, factor, factor)
    return fine.permute(0, 3, 1, 4, 2, 5).reshape(batch, channels, factor * height, factor * width)
