"""No two cameras are set alike: each multiplies the light by a gain of its own, and each channel by a white balance
of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator


class CameraGain(EffectParams):
    """How different."""

    exposure: float = Field(0.1, ge=0, le=4, description="Standard deviation of the gain, stops.")
    white_balance: float = Field(0.03, ge=0, le=4, description="Standard deviation of each channel's gain, stops.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p = evidence.params
    return above(
        float(np.hypot(p.exposure, p.white_balance)),
        bound,
        f"cameras differ by {p.exposure:g} stops, their channels by {p.white_balance:g}",
    )


def apply(light: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Light [h, w, 3] linear, times this camera's gains."""
    random = generator(seed, "camera_gain", shot.view)
    stops = random.normal() * params.exposure + random.normal(size=3) * params.white_balance
    return light * (2.0**stops).astype(np.float32)


EFFECT = SceneEffect(
    Effect(
        "camera_gain",
        "Give every camera an exposure and a white balance of its own.",
        "difference between cameras",
        0.005,
        "stops",
        _decide,
    ),
    CameraGain,
    "sensor",
    "posegaussian.stages.simulator.effects.camera_gain:apply",
    17.0,
)
