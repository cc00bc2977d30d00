"""The network's heads over the analytic prior of one picture."""

from __future__ import annotations

import math

import numpy as np
import torch

from posegaussian.stages.gaussians.prior import rays
from posegaussian.stages.network.model.heads import (
    HeadMaps,
    Prior,
    blend,
    growth,
    learned_normal,
    learned_opacity,
    learned_quaternion,
    learned_scale,
    normal_of,
    twist_of,
)

CHANNELS = {"scale": slice(0, 3), "rotation": slice(3, 6), "opacity": slice(6, 8)}
"""Of `network/numbers`."""


def over_prior(
    prior: tuple[np.ndarray, np.ndarray, np.ndarray],
    numbers: np.ndarray,
    share: np.ndarray,
    intrinsics: np.ndarray,
    turn: np.ndarray | None = None,
    single: bool = False,
    axes: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Scale [3, h, w] m, normal [3, h, w], opacity [2, h, w] and the share of the learned value [1, h, w], float32;
    with `turn` or `axes`, the cosine and sine of the twist [2, h, w], too.

    prior: scale, normal and opacity as `posegaussian.stages.gaussians.run.prior` gives them; numbers [8, h, w] of the
    heads, of which `turn` [1, h, w] is the first of a quaternion, and `single` says that one opacity counts; share
    [h, w] 0..1 of what they say; `axes` [1] the turn in the picture of the axes that scale and rotation are said along,
    radians.
    """
    scale, normal, opacity = (torch.from_numpy(np.ascontiguousarray(m, np.float32))[None] for m in prior)
    x = {name: torch.from_numpy(numbers[c].astype(np.float32))[None] for name, c in CHANNELS.items()}
    ray = rays(intrinsics, *share.shape)
    toward = torch.from_numpy(ray / np.sqrt((ray**2).sum(axis=0)))[None]
    weight = torch.from_numpy(share.astype(np.float32))[None, None]
    if single:
        x["opacity"] = x["opacity"][:, :1]
    angle = None if axes is None else float(axes[0])
    if angle is not None:
        x["rotation"] = _leaning(x["rotation"], angle)
    if turn is None:
        rotation = learned_normal(x["rotation"], normal, toward)
    else:
        whole = torch.cat([torch.from_numpy(turn.astype(np.float32))[None], x["rotation"]], dim=1)
        rotation = learned_quaternion(whole, normal)
    analytic = Prior(torch.zeros_like(weight), scale, normal, opacity)
    said = HeadMaps(
        torch.zeros_like(weight),
        learned_scale(x["scale"], scale),
        rotation,
        learned_opacity(x["opacity"], opacity),
        torch.cat([torch.zeros_like(weight), weight], dim=1),
    )
    found = blend(analytic, said)
    size, twist, weight = found.scale, None if turn is None else twist_of(found.rotation), found.shares[:, 1:]
    if angle is not None:
        size, twist = turned_sizes(scale, growth(x["scale"]), weight, angle)
    maps = [size, normal_of(found.rotation), found.opacity, weight, *([] if twist is None else [twist])]
    return tuple(m[0].numpy() for m in maps)


def _leaning(x: torch.Tensor, angle: float) -> torch.Tensor:
    """What leans a normal [B, 3, h, w] towards (x, -y) of axes turned by `angle`, towards those of the picture."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0], x[:, 2]], dim=1)


def turned_sizes(
    prior: torch.Tensor, growth: torch.Tensor, share: torch.Tensor, angle: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Scale [B, 3, h, w] m and twist [B, 2, h, w] (cosine, sine) of the prior's scale, along the tangents, blended by
    `share` [B, 1, h, w] with what `growth` times it along tangents turned by `angle` makes of it.

    What is blended are the symmetric matrices whose eigenvalues are standard deviations, with axes as eigenvectors,
    in the plane of the tangents (x, -y): (1 - c) diag(prior) + c R diag(learned) R^T. With an angle of 0 that is the
    blend of every scale by itself. Of the names its axes may have those are taken whose twist is nearest to half the
    turn: neighbours do not swap theirs.
    """
    c, s = math.cos(angle), math.sin(angle)
    first, second, along = prior.unbind(dim=1)
    grown = [
        growth[:, 0] * (c * c * first + s * s * second),
        growth[:, 1] * (s * s * first + c * c * second),
    ]
    share = share[:, 0]
    xx = (1 - share) * first + share * (c * c * grown[0] + s * s * grown[1])
    yy = (1 - share) * second + share * (s * s * grown[0] + c * c * grown[1])
    xy = share * c * s * (grown[1] - grown[0])
    middle, half = (xx + yy) / 2, (xx - yy) / 2
    apart, turn = torch.hypot(half, xy), torch.atan2(xy, half) / 2
    swapped = torch.cos(2 * (turn + angle / 2)) < 0
    turn = torch.where(swapped, turn - torch.sign(turn + angle / 2) * math.pi / 2, turn)
    apart = torch.where(swapped, -apart, apart)
    scale = torch.stack([middle + apart, middle - apart, (1 - share) * along + share * growth[:, 2] * along], dim=1)
    return scale.clamp(min=0), torch.stack([torch.cos(turn), torch.sin(turn)], dim=1)
