"""A matting program draws the outline a little inside or outside, unevenly along it, and misses patches."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator
from posegaussian.storage.model.masks import foreground


class MaskError(EffectParams):
    """How wrong."""

    grow: float = Field(0.0, ge=-50, le=50, description="px the outline is moved outwards; negative: inwards.")
    wobble: float = Field(
        0.0, ge=0, le=50, description="Standard deviation of that along the outline, px, over patches of 24 px."
    )
    holes: int = Field(0, ge=0, le=100, description="Missing patches of 6 px radius a mask.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p = evidence.params
    return above(
        max(abs(p.grow), p.wobble, float(p.holes > 0)),
        bound,
        f"outlines are off by {p.grow:g} px and vary by {p.wobble:g} px, with {p.holes} holes a mask",
    )


def apply(mask: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Mask [h, w] uint8 as a matting program would give it: the soft outline drawn again at another signed distance."""
    import cv2

    if not mask.any():
        return mask
    random = generator(seed, "mask_error", shot.frame, shot.view)
    inside = foreground(mask).astype(np.uint8)
    far = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - cv2.distanceTransform(
        1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    far -= 0.5 * np.sign(far)
    shift = np.full(mask.shape, params.grow, dtype=np.float32)
    if params.wobble:
        h, w = mask.shape
        coarse = random.standard_normal((h // 24 + 2, w // 24 + 2)).astype(np.float32)
        shift += params.wobble * cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)
    out = np.clip(far + shift + 0.5, 0.0, 1.0)
    rows, columns = np.nonzero(inside)
    for k in random.integers(0, len(rows) or 1, size=params.holes if len(rows) else 0):
        y, x = np.ogrid[: mask.shape[0], : mask.shape[1]]
        out *= np.clip(np.hypot(y - rows[k], x - columns[k]) - 6.0, 0.0, 1.0)
    return np.rint(255 * out).astype(np.uint8)


EFFECT = SceneEffect(
    Effect("mask_error", "Draw the outline wrongly, as matting does.", "distance of the outline", 0.0, "px", _decide),
    MaskError,
    "mask",
    "posegaussian.stages.simulator.effects.mask_error:apply",
    4.0,
)
