"""Quaternions, as other people's splats hold them, to rotations."""

from __future__ import annotations

import torch


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """[N, 3, 3] rotations of quaternions [N, 4] (w, x, y, z) of any length but 0; differentiable.

    They are divided by their largest component before their length, so that neither 1e-30 nor 1e30 over- or underflows.
    A quaternion of length 0, or not finite, says nothing about a rotation: NaN, which the rasterizer masks and counts,
    and no gradient. float16 is widened to float32.
    """
    q = quaternions.float() if quaternions.dtype in (torch.float16, torch.bfloat16) else quaternions
    largest = q.detach().abs().amax(dim=1, keepdim=True)
    usable = torch.isfinite(largest) & (largest > 0)
    safe = torch.where(usable, q, torch.ones_like(q)) / torch.where(usable, largest, torch.ones_like(largest))
    w, x, y, z = (safe / torch.sqrt((safe * safe).sum(dim=1, keepdim=True))).unbind(1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    matrices = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    return torch.where(usable[:, :, None], matrices, torch.nan)
