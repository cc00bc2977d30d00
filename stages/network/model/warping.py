"""Features of a further view where a hypothesis of depth projects to, so that a third camera has its say."""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.network.model.correlation import exact

NEAREST = 1e-3
"""A point nearer than this to the plane of the other camera, or behind it, is not seen, metres."""


def projection(
    intrinsics: np.ndarray,
    world_to_camera: np.ndarray,
    other_intrinsics: np.ndarray,
    other_world_to_camera: np.ndarray,
    stride: int = 1,
) -> torch.Tensor:
    """[3, 4] float64: (u z, v z, z, 1) of a cell of one view -> (u' z', v' z', z') of the other's cells.

    Intrinsics [3, 3] in px and poses [4, 4] in metres, as in the archive; one cell is `stride` x `stride` px, and (u,
    v) are in the project's convention, where the centre of the first cell is (0.5, 0.5): it scales without an offset.
    """
    back = np.eye(4)
    back[:3, :3] = np.linalg.inv(intrinsics)
    return in_cells(
        torch.from_numpy(other_intrinsics @ (other_world_to_camera @ np.linalg.inv(world_to_camera))[:3] @ back), stride
    )


def in_cells(pixels: torch.Tensor, stride: int, lag: float = 0.0) -> torch.Tensor:
    """A `projection` [..., 3, 4] of pixels as one of cells of `stride` px, whose features lie `lag` px to the upper
    left of the cells' centres.

    A projection of zeros, by which nothing is seen, stays one.
    """
    cell = pixels.new_tensor([[1 / stride, 0, lag / stride], [0, 1 / stride, lag / stride], [0, 0, 1]])
    back = pixels.new_tensor([[stride, 0, -lag, 0], [0, stride, -lag, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return cell @ pixels @ back


def warp(features: torch.Tensor, depth: torch.Tensor, to_other: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of another view at N hypotheses of depth a cell, and whether that view holds the place.

    features: [B, C, h', w'] of the other view.
    depth: [B, N, h, w] metres along the optical axis of the view whose cells these are.
    to_other: [B, 3, 4] of `projection`.
    Returns [B, N, C, h, w], bilinear and at least float32, and [B, N, h, w] bool. What is not seen (beside the picture,
    behind the camera, a depth that is not finite or not positive) is 0 and passes no gradient.
    """
    dtype = exact(features.dtype)
    batch, count, height, width = depth.shape
    with torch.autocast(features.device.type, enabled=False):
        cells = torch.as_tensor(pixel_centres((width, height)), dtype=dtype, device=features.device)
        known = torch.isfinite(depth) & (depth > 0)
        z = torch.where(known, depth, 1).to(dtype)[..., None]
        matrix = to_other.to(features.device, dtype)[:, None, None, None]
        seen = (matrix @ torch.cat([cells * z, z, torch.ones_like(z)], dim=-1)[..., None])[..., 0]
        before = known & (seen[..., 2] > NEAREST)
        place = seen[..., :2] / torch.where(before, seen[..., 2], 1)[..., None]
        size = torch.tensor([features.shape[3], features.shape[2]], dtype=dtype, device=features.device)
        held = before & ((place >= 0) & (place <= size)).all(-1)
        # With align_corners off -1 and 1 are the edges of the picture: 2 place / size - 1 in our convention.
        grid = torch.where(held[..., None], 2 * place / size - 1, 0).reshape(batch, count * height, width, 2)
        found = F.grid_sample(features.to(dtype), grid, mode="bilinear", padding_mode="border", align_corners=False)
        found = found.reshape(batch, -1, count, height, width).transpose(1, 2)
        return found * held[:, :, None], held


def warped_correlation(
    first: torch.Tensor, others: list[tuple[torch.Tensor, torch.Tensor]], depth: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean product over the views that see each hypothesis [B, N, h, w], scaled by 1 / sqrt(C), and the share of views
    that do.

    first: features [B, C, h, w]; others: (features, projection) of each further view, as `warp` takes them;
    depth: [B, N, h, w] metres. Both results are 0 where no view sees the hypothesis, and without views.
    """
    dtype = exact(first.dtype)
    total = torch.zeros(depth.shape, dtype=dtype, device=first.device)
    views = torch.zeros_like(total)
    with torch.autocast(first.device.type, enabled=False):
        scaled = (first.to(dtype) / math.sqrt(first.shape[1]))[:, None]
        for features, to_other in others:
            found, seen = warp(features, depth, to_other)
            total, views = total + (scaled * found).sum(2), views + seen
        return total / views.clamp(min=1), views / max(len(others), 1)
