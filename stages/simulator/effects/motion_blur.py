"""A shutter stays open for a while: the picture is the mean light of what passes in that time."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class MotionBlur(EffectParams):
    """How long, and how finely it is sampled."""

    shutter: float = Field(0.5, gt=0, le=1, description="Share of the frame interval that the shutter is open.")
    moments: int = Field(5, ge=2, le=64, description="Moments that stand for the exposure.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    moved = evidence.params.shutter * evidence.exposure_motion
    return above(moved, bound, f"while the shutter is open the fastest joint moves {moved:.2f} px")


def apply(params: Any, interval: float) -> np.ndarray:
    """[n] seconds around the middle of the exposure, evenly over it."""
    return (
        np.arange(params.moments) + 0.5
    ) / params.moments * params.shutter * interval - 0.5 * params.shutter * interval


EFFECT = SceneEffect(
    Effect("motion_blur", "Keep the shutter open for a while.", "motion while the shutter is open", 0.5, "px", _decide),
    MotionBlur,
    "shutter",
    "posegaussian.stages.simulator.effects.motion_blur:apply",
    210.0,
)
