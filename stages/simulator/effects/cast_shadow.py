"""What stands between a lamp and a surface takes that lamp's light from it."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class CastShadow(EffectParams):
    """How strong."""

    strength: float = Field(1.0, ge=0, le=1, description="Share of a lamp's light that its shadow takes.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(evidence.params.strength, bound, f"shadows take {evidence.params.strength:.0%} of a lamp's light")


def apply(lit: np.ndarray, vertices: np.ndarray, normals: np.ndarray, tris: np.ndarray, params: Any) -> np.ndarray:
    """Lit [V, 1 + lights] with the share of each lamp that reaches a vertex."""
    from posegaussian.stages.simulator.render.light import LIGHTS
    from posegaussian.stages.simulator.render.shadow_maps import reached

    out = lit.copy()
    for k, light in enumerate(LIGHTS):
        out[:, 1 + k] *= 1.0 - params.strength * (1.0 - reached(vertices, normals, tris, light, 384))
    return out


EFFECT = SceneEffect(
    Effect("cast_shadow", "Let the body shade itself from the lamps.", "strength", 0.0, "1", _decide),
    CastShadow,
    "light",
    "posegaussian.stages.simulator.effects.cast_shadow:apply",
    4.0,
)
