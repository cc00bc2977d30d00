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
    learned_scale,
)

CHANNELS = {"scale": slice(0, 3), "rotation": slice(3, 6), "opacity": slice(6, 8)}
"""Of `network/numbers`."""


def over_prior(
    prior: tuple[np.ndarray, np.ndarray, np.ndarray],
    numbers: np.ndarray,
    confidence: np.ndarray,
    intrinsics: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scale [3, h, w] m, normal [3, h, w], opacity [2, h, w] and the share of the learned value [1, h, w], float32.

    prior: scale, normal and opacity as `posegaussian.stages.gaussians.run.prior` gives them; numbers [8, h, w] of the
    heads; confidence [h, w] 0..1.
    """
    scale, normal, opacity = (torch.from_numpy(np.ascontiguousarray(m, np.float32))[None] for m in prior)
    x = {name: torch.from_numpy(numbers[c].astype(np.float32))[None] for name, c in CHANNELS.items()}
    ray = rays(intrinsics, *confidence.shape)
    toward = torch.from_numpy(ray / np.sqrt((ray**2).sum(axis=0)))[None]
    share = torch.from_numpy(confidence.astype(np.float32))[None, None]
    analytic = Prior(torch.zeros_like(share), scale, normal, opacity)
    said = HeadMaps(
        torch.zeros_like(share),
        learned_scale(x["scale"], scale),
        learned_normal(x["rotation"], normal, toward),
        learned_opacity(x["opacity"], opacity),
        share,
    )
    found = blend(analytic, said)
    return found.scale[0].numpy(), found.rotation[0].numpy(), found.opacity[0].numpy(), found.confidence[0].numpy()
