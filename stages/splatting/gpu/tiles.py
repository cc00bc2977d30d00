"""Which Gaussian reaches which tile, nearest first, by torch's sorts on the device: the lists that the Triton kernels
read.

An intersection of a Gaussian with a tile has a slot; slots are numbered by Gaussian, so that what the backward pass
leaves in them is summed in one fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from posegaussian.stages.splatting.definition.scene import Camera, TooLarge

MOST_INTERSECTIONS = 2**31 - 1
"""Places in the lists are numbered in 32 bits."""


class GpuTileLists(NamedTuple):
    """The M intersections of K Gaussians, which come sorted by depth, with the tiles of a picture."""

    ids: torch.Tensor  # [M] int32
    """Gaussians by tile and depth."""
    slots: torch.Tensor  # [M] int32
    """Their slots."""
    starts: torch.Tensor  # [tiles + 1] int32
    """Where each tile's list begins."""
    bases: torch.Tensor  # [K + 1] int64
    """First slot of each Gaussian."""


def list_tiles(boxes: torch.Tensor, camera: Camera, tile: int) -> GpuTileLists:
    """Lists of boxes [K, 4] int32 or int64 of tiles (x0, y0, x1, y1), half open,
    of Gaussians sorted by depth. Raises TooLarge."""
    across, down = -(-camera.width // tile), -(-camera.height // tile)
    x0, y0, x1, y1 = boxes.unbind(1)
    wide, count = x1 - x0, (x1 - x0) * (y1 - y0)
    bases = torch.cat([count.new_zeros(1), torch.cumsum(count, 0)])
    total = int(bases[-1])
    if total > MOST_INTERSECTIONS:
        raise TooLarge(
            f"{total} intersections of {len(boxes)} Gaussians with tiles of {tile}x{tile} px, at most"
            f" {MOST_INTERSECTIONS}: render smaller pictures or drop Gaussians that cover all of them"
        )
    owner = torch.repeat_interleave(torch.arange(len(boxes), device=boxes.device), count, output_size=total)
    local = torch.arange(total, device=boxes.device) - bases[owner]
    place = (y0[owner] + local // wide[owner]) * across + x0[owner] + local % wide[owner]
    # slots are numbered by depth, so each list keeps that order
    place, slots = torch.sort(place.to(torch.int32), stable=True)
    starts = torch.searchsorted(
        place, torch.arange(across * down + 1, dtype=torch.int32, device=boxes.device), out_int32=True
    )
    return GpuTileLists(owner[slots].to(torch.int32), slots.to(torch.int32), starts, bases)
