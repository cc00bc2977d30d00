"""Maps in the order of memory that convolutions want, channels last;
torch's own functions fall back to another and copy."""

from __future__ import annotations

import torch


def stacked(*maps: torch.Tensor) -> torch.Tensor:
    """Maps [B, Ci, h, w] as one [B, C1 + C2 + ..., h, w] of the first one's dtype, channels last also where one has
    a single channel."""
    return torch.cat([m.to(maps[0].dtype).permute(0, 2, 3, 1) for m in maps], dim=3).permute(0, 3, 1, 2)


def unshuffled(maps: torch.Tensor, cell: int) -> torch.Tensor:
    """Maps [B, C, H, W] -> [B, C cell^2, H / cell, W / cell],
    the channels of `torch.nn.functional.pixel_unshuffle`, channels last."""
    batch, channels, height, width = maps.shape
    cells = maps.reshape(batch, channels, height // cell, cell, width // cell, cell).permute(0, 2, 4, 1, 3, 5)
    return cells.reshape(batch, height // cell, width // cell, channels * cell**2).permute(0, 3, 1, 2)


def shuffled(maps: torch.Tensor, cell: int) -> torch.Tensor:
    """The inverse: [B, C cell^2, h, w] -> [B, C, h cell, w cell], contiguous,
    in one copy of maps that are channels last."""
    batch, channels, height, width = maps.shape
    cells = (
        maps.permute(0, 2, 3, 1)
        .reshape(batch, height, width, channels // cell**2, cell, cell)
        .permute(0, 3, 1, 4, 2, 5)
    )
    return cells.reshape(batch, channels // cell**2, height * cell, width * cell)
