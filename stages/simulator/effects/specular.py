"""Skin, leather and smooth cloth mirror a share of the lamps;
where that shows depends on where the camera stands (Blinn-Phong)."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class Specular(EffectParams):
    """How shiny."""

    strength: float = Field(1.0, ge=0, le=10, description="Times the gloss of skin, cloth and shoes.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(
        evidence.params.strength,
        bound,
        f"surfaces shine {evidence.params.strength:g} times as much as dry skin and cotton",
    )


def apply(gloss: np.ndarray, params: Any) -> np.ndarray:
    """Gloss [L, 3] (share mirrored face-on, exponent, sheen) of every layer; without this effect nothing mirrors."""
    out = gloss.copy()
    out[:, (0, 2)] *= params.strength
    return out


EFFECT = SceneEffect(
    Effect("specular", "Let surfaces mirror the lamps.", "strength", 0.0, "1", _decide),
    Specular,
    "gloss",
    "posegaussian.stages.simulator.effects.specular:apply",
    7.0,
)
