"""Which Gaussian reaches which tile, nearest first: the lists that compositing reads, by two sorts of torch's and two
kernels.

An intersection of a Gaussian with a tile has a slot; slots are numbered by depth, those of one Gaussian after each
other, so that what the backward pass leaves in them is summed in one fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import triton
import triton.language as tl

from posegaussian.stages.splatting.definition.scene import Camera, TooLarge

MOST_INTERSECTIONS = 2**31 - 1
"""Places in the lists are numbered in 32 bits."""
BLOCK = 512
"""Intersections of a program."""


class DepthOrder(NamedTuple):
    """N Gaussians, nearest first, ties by index; those that reach no tile last."""

    ids: torch.Tensor  # [N] int64
    bases: torch.Tensor  # [N + 1] int64
    """First slot of each, and how many slots there are."""


class GpuTileLists(NamedTuple):
    """The M intersections of Gaussians with the tiles of a picture."""

    ids: torch.Tensor  # [M] int32
    """Gaussians by tile and depth."""
    slots: torch.Tensor  # [M] int32
    """Their slots."""
    starts: torch.Tensor  # [tiles + 1] int32
    """Where each tile's list begins."""


def by_depth(depths: torch.Tensor, reached: torch.Tensor) -> DepthOrder:
    """Of depths [N] int32 that sort as metres do, the largest for what reaches no tile, and how many tiles each
    reaches, [N] int32."""
    ids = torch.sort(depths, stable=True).indices
    bases = torch.zeros(len(ids) + 1, dtype=torch.int64, device=ids.device)
    torch.cumsum(reached[ids], 0, out=bases[1:])
    return DepthOrder(ids, bases)


def list_tiles(boxes: torch.Tensor, order: DepthOrder, total: int, camera: Camera, tile: int) -> GpuTileLists:
    """Lists of boxes [N, 4] int32 of tiles (x0, y0, x1, y1), half open, with `total` intersections in all. Raises
    TooLarge."""
    if total > MOST_INTERSECTIONS:
        raise TooLarge(
            f"{total} intersections of {len(boxes)} Gaussians with tiles of {tile}x{tile} px, at most"
            f" {MOST_INTERSECTIONS}: render smaller pictures or drop Gaussians that cover all of them"
        )
    across, down = -(-camera.width // tile), -(-camera.height // tile)
    # sorting takes half the passes where 16 bits number the tiles
    narrow = torch.int16 if across * down < 2**15 else torch.int32
    owners, ids, slots = (boxes.new_empty(total) for _ in range(3))
    places, starts = boxes.new_empty(total, dtype=narrow), boxes.new_empty(across * down + 1)
    with torch.cuda.device_of(boxes):
        if total:
            number = len(boxes)
            spread[(-(-total // BLOCK),)](
                order.ids, order.bases, boxes, places, owners, number, total, across, number.bit_length(), BLOCK=BLOCK
            )
        # slots are numbered by depth, so each list keeps that order
        listed = torch.sort(places, stable=True)
        gather[(-(-max(total, len(starts)) // BLOCK),)](
            *listed, owners, ids, slots, starts, total, len(starts), total.bit_length() + 1, BLOCK=BLOCK
        )
    return GpuTileLists(ids, slots, starts)


@triton.jit(do_not_specialize=["number", "total", "across", "steps"])
def spread(order, bases, boxes, places, owners, number, total, across, steps, BLOCK: tl.constexpr):
    """Fill places [M], the tile of each slot, and owners [M] int32, its Gaussian; `steps`: halvings of N until one is
    left."""
    slot = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    listed = slot < total
    low = tl.zeros([BLOCK], tl.int32)  # the last whose first slot is not behind this one
    high = low + number
    for _ in range(steps):
        middle = (low + high) // 2
        before = tl.load(bases + middle, mask=listed, other=0) <= slot
        low, high = tl.where(before, middle, low), tl.where(before, high, middle)
    owner = tl.load(order + low, mask=listed, other=0)
    local = (slot - tl.load(bases + low, mask=listed, other=0)).to(tl.int32)
    box = boxes + owner * 4
    x0, y0 = tl.load(box, mask=listed, other=0), tl.load(box + 1, mask=listed, other=0)
    wide = tl.load(box + 2, mask=listed, other=1) - x0
    tl.store(places + slot, (y0 + local // wide) * across + x0 + local % wide, mask=listed)
    tl.store(owners + slot, owner.to(tl.int32), mask=listed)


@triton.jit(do_not_specialize=["total", "number", "steps"])
def gather(places, order, owners, ids, slots, starts, total, number, steps, BLOCK: tl.constexpr):
    """Fill ids and slots [M] int32 of slots in their `order` [M] int64 by places [M], and starts: `number` of them,
    each the first place that is no lower; `steps`: halvings of M until none is left."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    listed = i < total
    slot = tl.load(order + i, mask=listed, other=0)
    tl.store(slots + i, slot.to(tl.int32), mask=listed)
    tl.store(ids + i, tl.load(owners + slot, mask=listed, other=0), mask=listed)
    if tl.program_id(0) * BLOCK < number:
        tile = i < number
        low = tl.zeros([BLOCK], tl.int32)
        high = low + total
        for _ in range(steps):
            open_ = tile & (low < high)
            middle = low + (high - low) // 2
            lower = tl.load(places + middle, mask=open_, other=0) < i
            low, high = tl.where(open_ & lower, middle + 1, low), tl.where(open_ & ~lower, middle, high)
        tl.store(starts + i, low, mask=tile)
