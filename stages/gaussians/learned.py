"""The network's heads over the analytic prior of one picture."""

from __future__ import annotations

import numpy as np
import torch

from posegaussian.stages.gaussians.prior import rays
from posegaussian.stages.network.model.heads import (
    HeadMaps,
    Prior,
    blend,
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
    confidence: np.ndarray,
    intrinsics: np.ndarray,
    turn: np.ndarray | None = None,
    single: bool = False,
) -> tuple[np.ndarray, ...]:
    """Scale [3, h, w] m, normal [3, h, w], opacity [2, h, w] and the share of the learned value [1, h, w], float32;
    with `turn`, the cosine and sine of the twist [2, h, w], too.

    prior: scale, normal and opacity as `posegaussian.stages.gaussians.run.prior` gives them; numbers [8, h, w] of the
    heads, of which `turn` [1, h, w] is the first of a quaternion, and `single` says that one opacity counts; confidence
    [h, w] 0..1.
    """
    scale, normal, opacity = (torch.from_numpy(np.ascontiguousarray(m, np.float32))[None] for m in prior)
    x = {name: torch.from_numpy(numbers[c].astype(np.float32))[None] for name, c in CHANNELS.items()}
    ray = rays(intrinsics, *confidence.shape)
    toward = torch.from_numpy(ray / np.sqrt((ray**2).sum(axis=0)))[None]
    share = torch.from_numpy(confidence.astype(np.float32))[None, None]
    if single:
        x["opacity"] = x["opacity"][:, :1]
    if turn is None:
        rotation = learned_normal(x["rotation"], normal, toward)
    else:
        whole = torch.cat([torch.from_numpy(turn.astype(np.float32))[None], x["rotation"]], dim=1)
        rotation = learned_quaternion(whole, normal)
    analytic = Prior(torch.zeros_like(share), scale, normal, opacity)
    said = HeadMaps(
        torch.zeros_like(share),
        learned_scale(x["scale"], scale),
        rotation,
        learned_opacity(x["opacity"], opacity),
        share,
    )
    found = blend(analytic, said)
    maps = [found.scale, normal_of(found.rotation), found.opacity, found.confidence]
    twist = [] if turn is None else [twist_of(found.rotation)]
    return tuple(m[0].numpy() for m in (*maps, *twist))
