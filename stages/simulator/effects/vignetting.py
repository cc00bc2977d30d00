"""Light that comes in at an angle a is dimmed by cos(a)^4 and by the lens's rim;
here, a share that grows with the radius squared."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above
from posegaussian.storage.model.cameras import points_from_integer_centres


class Vignetting(EffectParams):
    """How much."""

    corner: float = Field(0.3, ge=0, lt=1, description="Share of the light that the corner of the picture loses.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(evidence.params.corner, bound, f"the corners lose {evidence.params.corner:.0%} of their light")


def apply(light: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Light [h, w, 3] linear, dimmed towards the corners."""
    h, w = light.shape[:2]
    y, x = (points_from_integer_centres(np.arange(n)) / n * 2 - 1 for n in (h, w))
    return light * (1.0 - params.corner * 0.5 * (x[None] ** 2 + y[:, None] ** 2))[..., None].astype(np.float32)


EFFECT = SceneEffect(
    Effect("vignetting", "Dim the corners of the picture.", "light lost in the corner", 0.004, "1", _decide),
    Vignetting,
    "sensor",
    "posegaussian.stages.simulator.effects.vignetting:apply",
    19.0,
)
