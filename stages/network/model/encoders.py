"""The three encoders: of the picture, of the pose heatmaps, of a depth. One structure, three sets of weights.

A 3x3 convolution, then six residual units of widths w1, w2, w2, w3, w3, w4 with squeeze-and-excitation (Hu et al.
2018). All levels are returned, finest first: they are the skips of the decoder, and the last is correlated. At the
presets' widths the number of threads changes no byte where the last level has 4 x 4 cells or more; on fewer torch's
convolutions round differently.
"""

from __future__ import annotations

import itertools

import torch
import torch.nn.functional as F
from torch import nn

from posegaussian.stages.network.model.presets import GROUP, Downsampling, Normalisation, Preset

SQUEEZE = 4
"""A squeeze-and-excitation passes through this share of its channels."""
HEATMAP_CELL = 4
"""Pixels a cell of the archive's heatmaps."""
DOWN = {1: (3,), 2: (1, 3), 3: (1, 3, 5), 4: (1, 3, 4, 5)}
"""Number of down-samplings after the stem -> the units, counted from 0, that do them: where the width grows, as far
as there are such."""


def image_encoder(preset: Preset) -> Encoder:
    """Of colours [B, 3, H, W]."""
    return Encoder.of(3, preset)


def pose_encoder(preset: Preset, joints: int = 17) -> Encoder:
    """Of heatmaps [B, joints, h, w] of one cell per `preset.pose_cell` px, see `heatmaps_on`.

    At the cells they are stored with there is nothing to see between: levels finer than that are left out.
    """
    if preset.pose_cell == 1:
        return Encoder.of(joints, preset)
    skipped = preset.pose_cell.bit_length() - 1
    return Encoder(
        joints, preset.widths, 1, preset.stages - skipped, preset.normalisation, preset.residual, preset.downsampling
    )


def depth_encoder(preset: Preset, channels: int = 1) -> Encoder:
    """Of maps [B, channels, H, W]: one proportional to inverse depth first, then what is known of it."""
    return Encoder.of(channels, preset)


def heatmaps_on(heatmaps: torch.Tensor, cell: int) -> torch.Tensor:
    """Heatmaps [B, J, h, w] of one cell per 4 px on a grid of one per `cell` px (a power of 2): means of areas, or
    bilinear where finer.

    Raises ValueError for another cell, or where h or w do not hold whole cells.
    """
    if cell < 1 or cell & (cell - 1):
        raise ValueError(f"a cell of heatmaps of {cell} px; a power of 2")
    if cell < HEATMAP_CELL:
        # Channels last: three times as quick as contiguous, and what the convolution behind it wants.
        heatmaps = heatmaps.contiguous(memory_format=torch.channels_last)
        return F.interpolate(heatmaps, scale_factor=HEATMAP_CELL // cell, mode="bilinear", align_corners=False)
    times = cell // HEATMAP_CELL
    height, width = heatmaps.shape[-2:]
    if height % times or width % times:
        raise ValueError(
            f"heatmaps of {height} x {width} cells of {HEATMAP_CELL} px do not divide into cells of {cell} px; the"
            f" sides must be multiples of {times}"
        )
    return F.avg_pool2d(heatmaps, times)


class Encoder(nn.Module):
    """[B, C, H, W] -> features of every level; see the file's head."""

    channels: tuple[int, ...]
    """Of each level returned, finest first."""
    strides: tuple[int, ...]
    """Cells of the input a cell, of the same levels."""
    lag: float
    """Cells of the input by which features of the last level lie to the upper left of their cells' centres,
    in both directions."""

    def __init__(
        self,
        inputs: int,
        widths: tuple[int, int, int, int],
        stem_stride: int,
        stages: int,
        normalisation: Normalisation,
        residual: bool,
        downsampling: Downsampling,
    ) -> None:
        super().__init__()
        down = DOWN[stages - (stem_stride == 2)]
        w1, w2, w3, w4 = widths
        sides = [w1, w1, w2, w2, w3, w3, w4]
        self.inputs = inputs
        self.stem = nn.Sequential(
            *_reducing(inputs, w1, stem_stride == 2, downsampling),
            _normalisation(normalisation, w1),
            nn.ReLU(inplace=True),
        )
        self.units = nn.ModuleList(
            Unit(a, b, i in down, normalisation, residual, downsampling)
            for i, (a, b) in enumerate(itertools.pairwise(sides))
        )
        self.ends = frozenset([*(i - 1 for i in down), 5])
        self.channels = tuple(sides[i + 1] for i in sorted(self.ends))
        self.strides = tuple(stem_stride * 2**i for i in range(len(self.channels)))
        # A strided convolution centres its cells on the first of two; a mean of 2 x 2 lies in the middle.
        self.lag = (self.strides[-1] - 1) / 2 if downsampling == "stride" else 0.0

    @classmethod
    def of(cls, inputs: int, preset: Preset) -> Encoder:
        """An encoder of `inputs` channels as the preset has them."""
        return cls(
            inputs,
            preset.widths,
            preset.stem_stride,
            preset.stages,
            preset.normalisation,
            preset.residual,
            preset.downsampling,
        )

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """[B, inputs, H, W] -> [B, channels[i], H / strides[i], W / strides[i]] for each level, finest first.

        Strided convolutions leave features to the upper left of their cells' centres (`lag`), equally so in all views
        and encoders. Raises ValueError where H or W is not a positive multiple of the last stride.
        """
        if x.ndim != 4 or x.shape[1] != self.inputs:
            raise ValueError(
                f"an encoder of {self.inputs} channels was given {tuple(x.shape)}; [B, {self.inputs}, H, W]"
            )
        height, width = x.shape[-2:]
        stride = self.strides[-1]
        if height < stride or width < stride or height % stride or width % stride:
            raise ValueError(
                f"a picture of {height} x {width} px (height x width) does not divide into cells of {stride} px; pad"
                f" both sides to a multiple of {stride}"
            )
        x = self.stem(x)
        levels = []
        for i, unit in enumerate(self.units):
            x = unit(x)
            if i in self.ends:
                levels.append(x)
        return levels


class Unit(nn.Module):
    """Two 3x3 convolutions and a squeeze-and-excitation beside a shortcut; halves the resolution where `halves`."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        halves: bool,
        normalisation: Normalisation,
        residual: bool,
        downsampling: Downsampling,
    ) -> None:
        super().__init__()
        # A pool comes first here, so that both convolutions are as cheap as behind a stride.
        self.pool = nn.AvgPool2d(2) if halves and downsampling == "pool" else nn.Identity()
        stride = 2 if halves and downsampling == "stride" else 1
        self.body = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False),
            _normalisation(normalisation, outputs),
            nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, padding=1, bias=False),
            _normalisation(normalisation, outputs),
            SqueezeExcitation(outputs),
        )
        self.shortcut: nn.Module | None = None
        if residual:
            same = stride == 1 and inputs == outputs
            self.shortcut = (
                nn.Identity()
                if same
                else nn.Sequential(
                    nn.Conv2d(inputs, outputs, 1, stride, bias=False), _normalisation(normalisation, outputs)
                )
            )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, inputs, h, w] -> [B, outputs, h, w], h and w halved where the unit does so."""
        x = self.pool(x)
        y = self.body(x)
        return torch.relu_(y if self.shortcut is None else y + self.shortcut(x))


class SqueezeExcitation(nn.Module):
    """Each channel times a number in 0..1 that follows from the means of all channels of the same picture."""

    def __init__(self, channels: int, hidden: int | None = None) -> None:
        super().__init__()
        hidden = hidden or channels // SQUEEZE
        # Not 1x1 convolutions: on a grid of one cell their sums differ with the number of threads. SiLU and not ReLU:
        # behind a norm the means hardly differ between pictures, so a channel dead for one would be dead for all.
        self.gate = nn.Sequential(nn.Linear(channels, hidden), nn.SiLU(), nn.Linear(hidden, channels), nn.Sigmoid())

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, channels, h, w] -> the same shape."""
        return x * self.gate(x.mean((2, 3)))[:, :, None, None]


def _reducing(inputs: int, outputs: int, halves: bool, downsampling: Downsampling) -> list[nn.Module]:
    """A 3x3 convolution, strided or with a pool behind it where it `halves`."""
    if halves and downsampling == "pool":
        return [nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.AvgPool2d(2)]
    return [nn.Conv2d(inputs, outputs, 3, 2 if halves else 1, padding=1, bias=False)]


def _normalisation(kind: Normalisation, channels: int) -> nn.Module:
    return nn.GroupNorm(channels // GROUP, channels) if kind == "group" else nn.BatchNorm2d(channels)
