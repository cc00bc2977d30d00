"""The decoder: from the fused features up to the stem's resolution, with joint skips of image, depth and pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from torch import nn
from torch.nn import functional

from posegaussian.stages.network.model.update import pointwise

Normalisation = Literal["group", "batch"]


class Decoded(NamedTuple):
    """What the decoder gives."""

    features: torch.Tensor
    """[B, widths[0], h, w] at the resolution of the finest skip."""
    joint: torch.Tensor
    """[B, widths[-1], h', w'] the coarsest joint skip: f_joint of the pose-fusion loss."""


def _normalised(kind: Normalisation, channels: int) -> nn.Module:
    return nn.BatchNorm2d(channels) if kind == "batch" else nn.GroupNorm(max(1, channels // 8), channels)


class JointSkip(nn.Module):
    """One level's features of image, depth and, where the decoder sees it, pose: joined by a 1x1 convolution."""

    def __init__(self, image: int, depth: int, pose: int, out: int) -> None:
        """Channels of the three inputs (pose 0: the decoder does not see it) and of the result."""
        super().__init__()
        self.pose = pose
        self.join = pointwise(image + depth + pose, out)

    def forward(self, image: torch.Tensor, depth: torch.Tensor, pose: torch.Tensor | None) -> torch.Tensor:
        """[B, out, h, w] of three maps of equal size.

        Raises ValueError where pose features are missing, or are given to a decoder built without them.
        """
        if (pose is not None) != (self.pose > 0):
            raise ValueError(
                f"a joint skip of {self.pose} pose channels was given {'no' if pose is None else tuple(pose.shape)}"
                " pose features"
            )
        return self.join(torch.cat([image, depth] if pose is None else [image, depth, pose], dim=1))


class UpBlock(nn.Module):
    """Coarse features brought to a skip's size, joined with it, and two 3x3 convolutions with a residual."""

    def __init__(self, coarse: int, skip: int, out: int, normalisation: Normalisation) -> None:
        """Channels of the coarse features, of the skip and of the result."""
        super().__init__()
        self.enter = nn.Sequential(
            nn.Conv2d(coarse + skip, out, 3, padding=1), _normalised(normalisation, out), nn.ReLU(inplace=True)
        )
        self.refine = nn.Sequential(nn.Conv2d(out, out, 3, padding=1), _normalised(normalisation, out))

    def forward(self, coarse: torch.Tensor, skip: torch.Tensor) -> torch.Tensor:
        """[B, out, h, w] with the skip's h and w, which need not be twice the coarse ones."""
        x = functional.interpolate(coarse, size=skip.shape[-2:], mode="bilinear", align_corners=False)
        x = self.enter(torch.cat([x, skip], dim=1))
        return torch.relu_(x + self.refine(x))


class Decoder(nn.Module):
    """A U-Net decoder. Levels are counted from the finest:
    level 0 has the stem's resolution, the last one the fused features'."""

    def __init__(
        self,
        fused: int,
        image: Sequence[int],
        depth: Sequence[int],
        pose: Sequence[int] | None,
        widths: Sequence[int],
        normalisation: Normalisation = "group",
    ) -> None:
        """Channels of the fused features; per level, of the three encoders (pose 0: not on this level, None: on none)
        and of the decoder.

        Raises ValueError where the numbers of levels differ.
        """
        super().__init__()
        poses = [0] * len(widths) if pose is None else list(pose)
        if not (len(image) == len(depth) == len(poses) == len(widths) >= 1):
            raise ValueError(
                f"a decoder needs as many levels of every kind, got image {len(image)}, depth {len(depth)}, pose"
                f" {len(poses)}, widths {len(widths)}"
            )
        self.skips = nn.ModuleList(
            JointSkip(i, d, p, w) for i, d, p, w in zip(image, depth, poses, widths, strict=True)
        )
        coarser = [*widths[1:], fused]
        self.blocks = nn.ModuleList(UpBlock(c, w, w, normalisation) for c, w in zip(coarser, widths, strict=True))

    def forward(
        self,
        fused: torch.Tensor,
        image: Sequence[torch.Tensor],
        depth: Sequence[torch.Tensor],
        pose: Sequence[torch.Tensor | None] | None = None,
    ) -> Decoded:
        """Decode fused features [B, C, h', w'] with the encoders' features of every level, finest first; pose None
        where a level has none.

        Raises ValueError where the number of maps is not the number of levels.
        """
        poses = [None] * len(self.skips) if pose is None else list(pose)
        if not (len(image) == len(depth) == len(poses) == len(self.skips)):
            raise ValueError(
                f"a decoder of {len(self.skips)} levels was given {len(image)} image, {len(depth)} depth and"
                f" {len(poses)} pose maps"
            )
        joints = [skip(*maps) for skip, *maps in zip(self.skips, image, depth, poses, strict=True)]
        x = fused
        for block, joint in zip(reversed(self.blocks), reversed(joints), strict=True):
            x = block(x, joint)
        return Decoded(x, joints[-1])
