"""The cost volume of the offset sweep written down plainly: one torch call after the other, a whole picture each."""

from __future__ import annotations

import torch
from torch.nn.functional import grid_sample, unfold

from posegaussian.stages.matching.cost import COLOR, COLOR_CAP, FORBIDDEN, WORST


def cost_volume(
    first: torch.Tensor,
    mask: torch.Tensor,
    guide: torch.Tensor,
    low: torch.Tensor,
    high: torch.Tensor,
    offsets: torch.Tensor,
    others: torch.Tensor,
    sizes: torch.Tensor,
    transfers: torch.Tensor,
    corner: tuple[int, int],
    radius: int,
    noise: float,
    share: float,
) -> torch.Tensor:
    """[h, w, D] uint8; arguments and result as in `posegaussian.stages.matching.cost.cost_volume`,
    as tensors of any float type."""
    planes = [
        _combined(
            torch.stack(
                [
                    _score(first, mask, guide + o, *n, corner, radius, noise)
                    for n in zip(others, sizes, transfers, strict=True)
                ]
            ),
            share,
        )
        for o in offsets
    ]
    cost = torch.round(WORST * (1 - torch.stack(planes, dim=-1).clamp(0, 1)))
    surface = guide[..., None] + offsets
    allowed = mask[..., None] & (surface >= low[..., None]) & (surface <= high[..., None])
    return torch.where(allowed, cost, float(FORBIDDEN)).to(torch.uint8)


def _score(
    first: torch.Tensor,
    mask: torch.Tensor,
    surface: torch.Tensor,
    other: torch.Tensor,
    size: torch.Tensor,
    transfer: torch.Tensor,
    corner: tuple[int, int],
    radius: int,
    noise: float,
) -> torch.Tensor:
    """[h, w] how alike the windows of the first picture and of a neighbour at a surface of inverse depth [h, w] are;
    nan where unseen."""
    h, w = mask.shape
    y, x = torch.meshgrid(torch.arange(h) + corner[1], torch.arange(w) + corner[0], indexing="ij")
    point = torch.stack([x, y, torch.ones_like(x), surface]).to(first.dtype)
    u, v, depth = torch.einsum("ij,jhw->ihw", transfer.to(first.dtype), point)
    u, v = u / depth, v / depth
    width, height = size[0], size[1]
    seen = (depth > 1e-6) & (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    grid = torch.stack([2 * u / (other.shape[2] - 1) - 1, 2 * v / (other.shape[1] - 1) - 1], dim=-1)
    warped = grid_sample(other[None], grid[None], mode="bilinear", padding_mode="border", align_corners=True)[0] * mask
    own = first * mask
    count = _sum(mask[None].to(first.dtype), radius)[0].clamp(min=1)
    a, b = _sum(own, radius) / count, _sum(warped, radius) / count
    covariance = (_sum(own * warped, radius) / count - a * b).sum(dim=0)
    own_variance = (_sum(own * own, radius) / count - a * a).sum(dim=0)
    variance = (_sum(warped * warped, radius) / count - b * b).sum(dim=0)
    floor = noise * len(first)
    match = covariance / torch.sqrt((own_variance + floor) * (variance.clamp(min=0) + floor))
    like = 1 - torch.sqrt(((a - b) ** 2).mean(dim=0)) / COLOR_CAP
    score = (1 - COLOR) * match.clamp(min=0) + COLOR * like.clamp(min=0)
    return torch.where(seen, score, torch.nan)


def _sum(values: torch.Tensor, radius: int) -> torch.Tensor:
    """[C, h, w] sums over windows of 2 radius + 1, zero outside the picture."""
    side = 2 * radius + 1
    return unfold(values[:, None], side, padding=radius).sum(dim=1).reshape(values.shape)


def _combined(scores: torch.Tensor, share: float) -> torch.Tensor:
    """[h, w] mean of the best share of the neighbours that see a point [K, h, w], at least one; -1 where none does."""
    ordered = torch.sort(torch.nan_to_num(scores, nan=-torch.inf), dim=0, descending=True).values
    usable = (~torch.isnan(scores)).sum(dim=0)
    keep = torch.ceil(share * usable).clamp(min=1)
    taken = torch.arange(len(scores))[:, None, None] < keep
    return torch.where(usable > 0, torch.where(taken, ordered, 0).sum(dim=0) / keep, -1.0)
