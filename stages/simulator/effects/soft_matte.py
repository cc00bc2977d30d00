"""Matting programs are unsure at outlines: what they give rises from 0 to 1 over several pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class SoftMatte(EffectParams):
    """How soft."""

    width: float = Field(3.0, ge=0, le=50, description="px over which the matte of a straight outline rises by 80 %.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(evidence.params.width, bound, f"mattes rise over {evidence.params.width:g} px")


def apply(mask: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Mask [h, w] uint8 blurred by a Gaussian: an edge rises from 10 to 90 % over 2.563 standard deviations."""
    import cv2

    sigma = params.width / 2.563
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.rint(soft).astype(np.uint8)


EFFECT = SceneEffect(
    Effect("soft_matte", "Let mattes rise softly at outlines.", "width of the outline", 0.1, "px", _decide),
    SoftMatte,
    "mask",
    "posegaussian.stages.simulator.effects.soft_matte:apply",
    1.0,
)
