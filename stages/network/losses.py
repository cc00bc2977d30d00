"""What training minimises: render, depth sequence and pose fusion. A mask without a pixel costs 0 and has a gradient
of 0, never NaN."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

WINDOW, SIGMA = 11, 1.5
FAINT = 1e-3
"""Mean square of heatmaps below which their error is no longer taken as a share of it: about half of what 17 joints
of a person have in a crop."""


def masked_mean(values: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
    """Mean of values [B, C, h, w] weighted by mask [B, 1, h, w] (bool or weights; None: all); 0 where no pixel counts.

    What lies where the mask is 0 may be anything, NaN too.
    """
    if mask is None:
        return values.mean() if values.numel() else values.sum()
    weight = mask.to(values.dtype).expand_as(values)
    total = weight.sum()
    return torch.where(weight > 0, values * weight, 0).sum() / torch.where(total > 0, total, 1)


def _blur(x: torch.Tensor) -> torch.Tensor:
    """11x11 Gaussian window, edges reflected with the edge pixel repeated, as the metrics have it."""
    offsets = torch.arange(WINDOW, device=x.device, dtype=x.dtype) - WINDOW // 2
    kernel = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    kernel = kernel / kernel.sum()
    for dim in (-2, -1):
        n = x.shape[dim]
        place = torch.arange(-(WINDOW // 2), n + WINDOW // 2, device=x.device) % (2 * n)
        x = x.index_select(dim, torch.where(place < n, place, 2 * n - 1 - place))
    b, c, h, w = x.shape
    x = functional.conv2d(x.reshape(b * c, 1, h, w), kernel.reshape(1, 1, -1, 1))
    return functional.conv2d(x, kernel.reshape(1, 1, 1, -1)).reshape(b, c, h - WINDOW + 1, w - WINDOW + 1)


def ssim_map(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """[B, C, h, w] SSIM at every pixel of pictures [B, C, h, w] in 0..1, the definition of
    stages/metrics/measures/ssim.py, differentiable.

    In float32 a variance is a difference of nearly equal numbers: the squares are taken of what differs from the
    picture's mean, variances below 0 are 0, and SSIM stays within -1..1; where one of these bounds acts, the gradient
    is 0.
    """
    c1, c2 = 0.01**2, 0.03**2
    x, y = (p.float() if p.dtype in (torch.float16, torch.bfloat16) else p for p in (picture, truth))
    centre = ((x + y) / 2).detach().mean(dim=(-2, -1), keepdim=True)
    u, v = x - centre, y - centre
    mu, mv = _blur(u), _blur(v)
    var_x, var_y = ((_blur(p * p) - m * m).clamp(min=0) for p, m in ((u, mu), (v, mv)))
    covariance = _blur(u * v) - mu * mv
    mean_x, mean_y = mu + centre, mv + centre
    similarity = (
        (2 * mean_x * mean_y + c1) * (2 * covariance + c2) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))
    )
    return similarity.clamp(-1, 1)


def render_loss(
    picture: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None = None, beta: float = 0.5, gamma: float = 0.5
) -> torch.Tensor:
    """Photometric loss: beta MAE + gamma (1 - SSIM) of pictures [B, C, h, w] in 0..1, over the pixels of mask [B, 1, h,
    w]. Always float32 or wider.

    SSIM's windows look beyond the mask: what is not finite there counts as 0 in both pictures.
    """
    with torch.autocast(picture.device.type, enabled=False):
        x, y = (p.float() if p.dtype in (torch.float16, torch.bfloat16) else p for p in (picture, truth))
        if mask is not None:
            keep = (mask > 0) | (torch.isfinite(x) & torch.isfinite(y))
            x, y = torch.where(keep, x, 0), torch.where(keep, y, 0)
        return beta * masked_mean((x - y).abs(), mask) + gamma * masked_mean(1 - ssim_map(x, y), mask)


def sequence_loss(
    predictions: Sequence[torch.Tensor], truth: torch.Tensor, valid: torch.Tensor, mu: float = 0.9
) -> torch.Tensor:
    """Depth loss: sum over t = 1..T of mu^(T - t) mean |d_t - d| over the valid pixels; any T >= 1.

    Args:
        predictions: T maps [B, 1, h, w], disparity in px, the last one the best.
        truth: [B, 1, h, w] px; what is not finite never counts.
        valid: [B, 1, h, w] bool, where there is a truth.
        mu: weight of a prediction against that of the next.

    Raises:
        ValueError: without a prediction.
    """
    if not predictions:
        raise ValueError("a depth sequence of 0 predictions has no loss; at least 1 iteration is needed")
    counts = (valid > 0) & torch.isfinite(truth)
    true = torch.where(counts, truth, 0)
    last = len(predictions) - 1
    return torch.stack(
        [mu ** (last - t) * masked_mean((p - true).abs(), counts) for t, p in enumerate(predictions)]
    ).sum()


def standardised(features: torch.Tensor, floor: float = 1e-4) -> torch.Tensor:
    """Features [B, C, h, w] less their mean over channels, divided by their deviation; the floor of the variance
    bounds the gradient by 100."""
    centred = features - features.mean(dim=1, keepdim=True)
    return centred / torch.sqrt((centred * centred).mean(dim=1, keepdim=True) + floor)


class PoseFusionTerms(NamedTuple):
    """The two terms of the pose-fusion loss."""

    alignment: torch.Tensor
    """lambda |predictor(f_joint) - f_pose|, both standardised; no gradient reaches f_pose."""
    heatmaps: torch.Tensor
    """Squared error of the heatmaps that a 1x1 convolution reads from f_pose, as a share of their own squares."""


class PoseFusion(nn.Module):
    """lambda |f_joint - f_pose|_1, made so that it cannot be won by making both constant.

    f_pose is a target only (stop-gradient), both sides are standardised, a 1x1 predictor stands between them, and
    f_pose must still tell the heatmaps: without these the effective rank of both falls to 2 and the depth gets worse.
    """

    def __init__(self, joint: int, pose: int, joints: int = 17, weight: float = 1.0) -> None:
        """Channels of f_joint and f_pose, number of heatmaps, lambda."""
        super().__init__()
        self.predictor = nn.Conv2d(joint, pose, 1)
        self.reader = nn.Conv2d(pose, joints, 1)
        # else the first thing that is learnt would be to say nothing of joints that are not there
        nn.init.zeros_(self.reader.weight)
        assert self.reader.bias is not None
        nn.init.zeros_(self.reader.bias)
        self.weight = weight

    def forward(
        self, f_joint: torch.Tensor, f_pose: torch.Tensor, heatmaps: torch.Tensor, mask: torch.Tensor | None = None
    ) -> PoseFusionTerms:
        """Of f_joint [B, Cj, h, w], f_pose [B, Cp, h, w], heatmaps [B, J, H, W] (area-pooled to h, w) and mask [B,
        1, h, w]."""
        with torch.autocast(f_joint.device.type, enabled=False):
            aligned, pose = (f.float() if f.dtype in (torch.float16, torch.bfloat16) else f for f in (f_joint, f_pose))
            aligned = standardised(self.predictor(aligned))
            alignment = masked_mean((aligned - standardised(pose.detach())).abs(), mask)
            height, width = pose.shape[-2:]
            target = functional.adaptive_avg_pool2d(heatmaps.to(pose.dtype), (height, width))
            power = masked_mean(target**2, mask)
            error = masked_mean((self.reader(pose) - target) ** 2, mask)
            # an empty picture (no heatmap anywhere) must not divide by nothing
            return PoseFusionTerms(self.weight * alignment, error / power.clamp(min=FAINT))


def _rows(features: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
    """[N, C] float64 of the masked pixels of [B, C, h, w]."""
    rows = features.detach().double().permute(0, 2, 3, 1)
    return rows.reshape(-1, rows.shape[-1]) if mask is None else rows[mask[:, 0] > 0]


def effective_rank(features: torch.Tensor, mask: torch.Tensor | None = None) -> float:
    """How many directions features [B, C, h, w] spread over: exp of the entropy of their singular values (Roy and
    Vetterli, 2007).

    1 .. C; 0 of features that are the same everywhere.
    """
    rows = _rows(features, mask)
    if rows.shape[0] < 2:
        return 0.0
    values = torch.linalg.svdvals(rows - rows.mean(dim=0))
    total = float(values.sum())
    if not total > 1e-12 * max(1.0, float(rows.abs().max())) * rows.shape[0]:
        return 0.0
    p = values / total
    return math.exp(float(-(p * torch.log(p.clamp(min=1e-300))).sum()))


def heatmap_probe(
    features: torch.Tensor, heatmaps: torch.Tensor, mask: torch.Tensor | None = None, ridge: float = 1e-6
) -> float:
    """R^2 with which a linear map reads heatmaps [B, J, h, w] from features [B, C, h, w]: fitted on every other pixel,
    measured on the rest.

    1: all is there; 0 or less: nothing. 0 where the heatmaps are constant. `ridge` is relative to the features' power.
    """
    x, y = _rows(features, mask), _rows(heatmaps, mask)
    if x.shape[0] < 4:
        return 0.0
    x, y = x - x[::2].mean(dim=0), y - y[::2].mean(dim=0)
    gram = x[::2].T @ x[::2]
    damping = ridge * float(gram.diagonal().mean()) + 1e-12
    weights = torch.linalg.solve(
        gram + damping * torch.eye(x.shape[1], dtype=x.dtype, device=x.device), x[::2].T @ y[::2]
    )
    total = float((y[1::2] ** 2).sum())
    return 1 - float(((x[1::2] @ weights - y[1::2]) ** 2).sum()) / total if total > 0 else 0.0
