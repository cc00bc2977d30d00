"""The reference rasterizer: front-to-back compositing of projected Gaussians over tiles, in plain vectorised torch.

For every pixel, with Gaussians sorted by depth (ties by index), alpha_i = min(opacity_i exp(-q_i), alpha_max), skipped
below alpha_min, and T_i = prod_{j<i} (1 - alpha_j): color = sum_i T_i alpha_i color_i, premultiplied on black. It is
differentiated by autograd. The result does not depend on the tile size, nor on the number of threads: every operation
is elementwise, and on the CPU no operand is large enough for torch to split it between threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch

from posegaussian.stages.splatting.definition.projection import Projected, project
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from posegaussian.storage.model.cameras import PIXEL_CENTRE

TILE = 4
"""Side of a tile, px. Small, because pixel-aligned Gaussians are: 0.17 s a 512 px picture, against 0.32 with 8 and
0.75 with 16."""
CHUNK = 8
"""Gaussians of a tile that are fetched at once; between chunks finished tiles are laid aside."""
BATCH_PIXELS = {"cpu": 2**15, "cuda": 2**21}
"""Pixels composited together. torch splits elementwise work between threads above 2^15 elements, where its vector
code may hand over to scalar code that rounds `exp` differently; a GPU wants wide batches."""
BATCH_PAIRS = 2**22
"""(tile, Gaussian) pairs listed at once; a region with more is halved."""


CHANNELS = 8
"""Values that are composited: colour, alpha, depth, normal."""


class _Region(NamedTuple):
    """A rectangle of tiles, half open."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def tiles(self) -> int:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def halves(self) -> tuple[_Region, _Region]:
        if self.x1 - self.x0 >= self.y1 - self.y0:
            middle = (self.x0 + self.x1) // 2
            return self._replace(x1=middle), self._replace(x0=middle)
        middle = (self.y0 + self.y1) // 2
        return self._replace(y1=middle), self._replace(y0=middle)


def composite(gaussians: Gaussians, camera: Camera, cutoffs: Cutoffs, tile: int = TILE) -> tuple[torch.Tensor, int]:
    """[h, w, CHANNELS] picture of one camera and the number of masked Gaussians, in their dtype and on their device.

    Any N, picture size and tile size are valid; an empty scene gives zeros. Memory is bounded by `BATCH_PAIRS` and
    `BATCH_PIXELS` when no gradient is recorded.
    """
    p = project(gaussians, camera, cutoffs)
    features, boxes, _ = sorted_by_depth(p, camera, tile)
    across, down = -(-camera.width // tile), -(-camera.height // tile)
    picture = features.new_zeros((across * down, CHANNELS, tile * tile))
    # an empty part keeps the picture in autograd's graph when nothing is seen: gradients are zero then, not an error
    parts, places = (
        [features[:0, :CHANNELS, None].expand(0, CHANNELS, tile * tile)],
        [torch.zeros(0, dtype=torch.int64, device=picture.device)],
    )
    for region, lists, starts, counts in _tile_lists(boxes, _Region(0, 0, across, down), tile):
        columns = torch.arange(region.x0, region.x1, device=picture.device)
        rows = torch.arange(region.y0, region.y1, device=picture.device)
        tiles = (rows[:, None] * across + columns).reshape(-1)  # [B]
        done, values = _composite(
            features, lists, starts, counts, _pixel_centres(tiles, across, tile, features), cutoffs
        )
        places.append(tiles[done])
        parts.append(values)
    picture = picture.index_put((torch.cat(places),), torch.cat(parts))
    picture = (
        picture.reshape(down, across, CHANNELS, tile, tile)
        .permute(0, 3, 1, 4, 2)
        .reshape(down * tile, across * tile, CHANNELS)
    )
    return picture[: camera.height, : camera.width], p.masked


class ByDepth(NamedTuple):
    """Projected Gaussians by ascending depth, ties by index."""

    features: torch.Tensor  # [K, 14]
    """u, v, whitening, opacity, color, z, normal."""
    boxes: torch.Tensor  # [K, 4] int64
    """Tiles x0, y0, x1, y1 that hold every pixel centre it can reach, half open."""
    ids: torch.Tensor  # [K]
    """Which of the input's they are."""


def sorted_by_depth(p: Projected, camera: Camera, tile: int) -> ByDepth:
    """What is composited, and where, with tiles of `tile` px a side; features carry gradients."""
    order = torch.argsort(p.depth.detach(), stable=True)
    features = torch.cat(
        [p.mean, p.whitening, p.opacity[:, None], p.color, p.depth[:, None], p.normal], dim=1
    ).index_select(0, order)
    with torch.no_grad():
        mean, extent = p.mean[order], p.extent[order]
        limit = mean.new_tensor([camera.width, camera.height])
        # pixel index whose centre is inside
        first = torch.minimum(torch.ceil(mean - extent - PIXEL_CENTRE).clamp(min=0), limit).to(torch.int64)
        last = torch.minimum(torch.floor(mean + extent - PIXEL_CENTRE).clamp(min=-1), limit - 1).to(torch.int64)
        empty = (last < first).any(dim=1, keepdim=True)
        low, high = first // tile, last // tile + 1
        boxes = torch.cat([low, torch.where(empty, low, high)], dim=1)
    return ByDepth(features, boxes, p.index[order])


def _tile_lists(
    boxes: torch.Tensor, region: _Region, tile: int
) -> Iterator[tuple[_Region, torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Lists of Gaussians of every tile of the region, halving it until batches are small.

    Yields (region, lists [M] indices grouped by tile and by depth within it, starts [B], counts [B]).
    """
    x0, x1 = (boxes[:, i].clamp(region.x0, region.x1) for i in (0, 2))
    y0, y1 = (boxes[:, i].clamp(region.y0, region.y1) for i in (1, 3))
    n = (x1 - x0) * (y1 - y0)
    pairs = int(n.sum())
    if pairs == 0:
        return
    batch = BATCH_PIXELS["cuda" if boxes.is_cuda else "cpu"]
    if region.tiles > 1 and (pairs > BATCH_PAIRS or region.tiles * tile * tile > batch):
        touching = boxes[n > 0]
        index = torch.nonzero(n > 0)[:, 0]
        for half in region.halves():
            for leaf, lists, starts, counts in _tile_lists(touching, half, tile):
                yield leaf, index[lists], starts, counts
        return
    owner = torch.repeat_interleave(torch.arange(len(n), device=n.device), n)  # [M], ascending depth
    local = torch.arange(pairs, device=n.device) - torch.repeat_interleave(torch.cumsum(n, 0) - n, n)
    across = (x1 - x0)[owner]
    slot = (y0[owner] + local // across - region.y0) * (region.x1 - region.x0) + x0[owner] + local % across - region.x0
    counts = torch.bincount(slot, minlength=region.tiles)
    yield region, owner[torch.argsort(slot, stable=True)], torch.cumsum(counts, 0) - counts, counts


def _pixel_centres(
    tiles: torch.Tensor, across: int, tile: int, like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Columns and rows [B, tile^2] of the pixel centres of each tile, px."""
    inside = torch.arange(tile * tile, device=tiles.device)
    x = (tiles % across)[:, None] * tile + inside % tile
    y = torch.div(tiles, across, rounding_mode="floor")[:, None] * tile + torch.div(inside, tile, rounding_mode="floor")
    return x.to(like.dtype) + PIXEL_CENTRE, y.to(like.dtype) + PIXEL_CENTRE


def _composite(
    features: torch.Tensor,
    lists: torch.Tensor,
    starts: torch.Tensor,
    counts: torch.Tensor,
    centres: tuple[torch.Tensor, torch.Tensor],
    cutoffs: Cutoffs,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Blend the listed Gaussians of B tiles of P pixels front to back.

    Returns (slots [B'], values [B', CHANNELS, P] = premultiplied colour, alpha, depth, normal): tiles in the order they
    were finished, a tile being finished when its list ends or when none of its pixels lets light through.
    """
    slots = torch.nonzero(counts)[:, 0]
    x, y = centres[0][slots], centres[1][slots]
    transmittance, total = torch.ones_like(x), x.new_zeros((len(x), CHANNELS, x.shape[1]))
    done, values, first = [], [], 0
    while len(slots):
        step = first + torch.arange(CHUNK, device=lists.device)
        listed = step < counts[slots, None]  # [B, CHUNK]
        g = features[lists[(starts[slots, None] + step).clamp(max=len(lists) - 1)]]  # [B, CHUNK, 14]
        for i in range(CHUNK):
            transmittance, total = _blend(g[:, i, :, None], listed[:, i, None], x, y, transmittance, total, cutoffs)
        first += CHUNK
        alive = (counts[slots] > first) & (transmittance.detach() > cutoffs.transmittance_stop).any(dim=1)
        if not bool(alive.all()):
            done.append(slots[~alive])
            values.append(total[~alive])
            slots, x, y, transmittance, total = slots[alive], x[alive], y[alive], transmittance[alive], total[alive]
    return torch.cat(done), torch.cat(values)


def _blend(
    g: torch.Tensor,
    listed: torch.Tensor,
    x: torch.Tensor,
    y: torch.Tensor,
    transmittance: torch.Tensor,
    total: torch.Tensor,
    cutoffs: Cutoffs,
) -> tuple[torch.Tensor, torch.Tensor]:
    """One Gaussian a tile, g [B, 14, 1], over its P pixels. The transmittance runs on past the stop: it never rises
    again, so that everything behind the first dropped Gaussian is dropped with it.
    """
    dx, dy = x - g[:, 0], y - g[:, 1]
    p, q = g[:, 2] * dx + g[:, 3] * dy, g[:, 4] * dx + g[:, 5] * dy
    alpha = (g[:, 6] * torch.exp(-0.5 * (p * p + q * q))).clamp(max=cutoffs.alpha_max)
    alpha = torch.where(listed & (alpha >= cutoffs.alpha_min), alpha, 0.0)
    behind = transmittance * (1 - alpha)
    weight = torch.where(behind > cutoffs.transmittance_stop, transmittance * alpha, 0.0)
    payload = torch.cat([g[:, 7:10], torch.ones_like(g[:, :1]), g[:, 10:]], dim=1)  # [B, CHANNELS, 1]
    return behind, total + weight[:, None, :] * payload
