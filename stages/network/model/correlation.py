"""Correlation of two rectified feature maps along their rows, and look-ups in it.

After RAFT-Stereo (Lipson et al. 2021): a pyramid of the products of every column with every column of the same row,
read at 2 r + 1 places around the current match on every level. Four things differ, because each has been met as a
fault: features are scaled by 1 / sqrt(C) before the product, which is float32 even under autocast; a level's cell is
the mean of the columns that exist, whatever the width; a column is looked up at the centre of the cell that holds it;
and where the volume would be large the products are made at the look-up instead.

Columns are indices of the feature map, 0 the first; a match of column j lies at column j - disparity of the other view.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

VOLUME_BYTES = 256 * 2**20
"""Above this the products are made at each look-up: slower, but less than 3 feature maps are kept, and not height x
width^2.

With gradients each look-up keeps 2 r + 2 maps a level, too: train on crops that fit.
"""


def volume_bytes(batch: int, height: int, width: int, other_width: int, levels: int) -> int:
    """Bytes of all levels of a float32 volume."""
    return 4 * batch * height * width * sum(-(-other_width // 2**level) for level in range(levels))


def columns_of(disparity: torch.Tensor) -> torch.Tensor:
    """Columns of the other view [B, 1, h, w] that match under a disparity [B, 1, h, w], cells; at least float32."""
    disparity = disparity.to(exact(disparity.dtype))
    return torch.arange(disparity.shape[-1], dtype=disparity.dtype, device=disparity.device) - disparity


def exact(dtype: torch.dtype) -> torch.dtype:
    """Float32, or float64 where that was given: correlation and coordinates lose pixels in half precision."""
    return torch.promote_types(dtype, torch.float32)


class Correlation:
    """Scaled products of two feature maps [B, C, h, w] and [B, C, h, w'] along rows, on levels of 1, 2, 4, ... columns
    a cell.

    Raises ValueError where the maps differ in batch, channels or height, or hold nothing, or where `levels` < 1 or
    `radius` < 0. Not checked: that they are finite.
    """

    def __init__(
        self, first: torch.Tensor, second: torch.Tensor, levels: int, radius: int, budget: int = VOLUME_BYTES
    ) -> None:
        if (
            first.ndim != 4
            or second.ndim != 4
            or first.shape[:3] != second.shape[:3]
            or 0 in (*first.shape, *second.shape)
        ):
            raise ValueError(
                f"features of {tuple(first.shape)} and {tuple(second.shape)} do not correlate along rows; both must be"
                " [B, C, h, w], equal but for w, and not empty"
            )
        if levels < 1 or radius < 0:
            raise ValueError(f"a correlation of {levels} levels and radius {radius}; at least 1 level and radius 0")
        batch, channels, height, width = first.shape
        self.radius, self.shape = radius, (batch, 1, height, width)
        with torch.autocast(first.device.type, enabled=False):
            dtype = torch.promote_types(exact(first.dtype), second.dtype)
            self.first = first.to(dtype) / math.sqrt(channels)
            self.second = [_cells(second.to(dtype), level) for level in range(levels)]
            self.volume: list[torch.Tensor] | None = None
            if volume_bytes(batch, height, width, second.shape[3], levels) <= budget:
                rows = self.first.permute(0, 2, 3, 1)
                self.volume = [rows @ s.permute(0, 2, 1, 3) for s in self.second]

    @property
    def channels(self) -> int:
        """Values a pixel that a look-up gives: levels x (2 radius + 1)."""
        return len(self.second) * (2 * self.radius + 1)

    def look_up(self, columns: torch.Tensor, coordinate_gradient: bool = False) -> torch.Tensor:
        """Correlation [B, levels x (2 r + 1), h, w] around columns [B, 1, h, w] of the second map, between cells
        linearly.

        Level by level, -r to r cells about the place. A cell beside the map counts 0, which is what features that have
        nothing to do with each other give: from the last cell the value falls linearly over one cell, and stays 0
        however far the column is off. With `coordinate_gradient` the gradient of the interpolation reaches the columns,
        else only the features. A column that is not a number gives what is not a number.
        """
        if tuple(columns.shape) != self.shape:
            raise ValueError(f"columns of shape {tuple(columns.shape)} for a correlation of {self.shape}")
        columns = columns.to(self.first.dtype)
        columns = columns[:, 0] if coordinate_gradient else columns[:, 0].detach()
        with torch.autocast(columns.device.type, enabled=False):
            return torch.cat([self._around(level, columns) for level in range(len(self.second))], dim=1)

    def _around(self, level: int, columns: torch.Tensor) -> torch.Tensor:
        """One level [B, 2 r + 1, h, w] about columns [B, h, w]."""
        width = self.second[level].shape[-1]
        # The centre of cell i is at column 2^l i + (2^l - 1) / 2.
        # Farther than the clamp all is 0 anyway, and the index stays small.
        place = ((columns - (2**level - 1) / 2) / 2**level).clamp(-self.radius - 2, width + self.radius + 1)
        left = place.detach().floor()
        part = (place - left)[:, None]
        steps = torch.arange(-self.radius, self.radius + 2, device=columns.device)
        index = left.nan_to_num().long()[:, None] + steps[:, None, None]
        inside = (index >= 0) & (index < width)
        taps = self._taps(level, index.clamp(0, width - 1)) * inside
        return (1 - part) * taps[:, :-1] + part * taps[:, 1:]

    def _taps(self, level: int, index: torch.Tensor) -> torch.Tensor:
        """Products [B, n, h, w] with the cells `index` [B, n, h, w]."""
        if self.volume is not None:
            return self.volume[level].gather(3, index.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        second, shape = self.second[level], self.first.shape
        return torch.stack(
            [(self.first * second.gather(3, i[:, None].expand(shape))).sum(1) for i in index.unbind(1)], dim=1
        )


def _cells(features: torch.Tensor, level: int) -> torch.Tensor:
    """Means [B, C, h, ceil(w / 2^level)] of 2^level columns, the last of those that are left.

    The product is linear, so this is the mean of the products. Each level is made of the finest: a mean of means would
    give the columns of an incomplete cell more weight.
    """
    if level == 0:
        return features
    size = min(2**level, features.shape[-1])
    return F.avg_pool2d(features, (1, size), (1, size), ceil_mode=True)
