"""Folds and armpits see less of the sky: what the body itself hides of it brings no light."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class AmbientOcclusion(EffectParams):
    """How strong."""

    strength: float = Field(1.0, ge=0, le=1, description="1: as geometry has it; 0: none.")
    directions: int = Field(24, ge=8, le=512, description="Directions that stand for all around.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(
        evidence.params.strength, bound, f"hidden sky dims what it would light, by {evidence.params.strength:.0%}"
    )


def apply(lit: np.ndarray, vertices: np.ndarray, normals: np.ndarray, tris: np.ndarray, params: Any) -> np.ndarray:
    """Lit [V, 1 + lights] with the share of the sky that reaches each vertex:
    the cosine-weighted mean over directions."""
    from posegaussian.stages.simulator.render.shadow_maps import reached

    n = params.directions
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    # a spiral of equal areas
    towards = np.stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z], axis=1)
    total, seen = np.zeros(len(vertices)), np.zeros(len(vertices))
    for d in towards:
        cosine = np.maximum(normals @ d, 0.0)
        total += cosine
        seen += cosine * reached(vertices, normals, tris, d, 160)
    out = lit.copy()
    out[:, 0] *= 1.0 - params.strength * (1.0 - seen / np.maximum(total, 1e-9))
    return out


EFFECT = SceneEffect(
    Effect("ambient_occlusion", "Dim what sees little of the sky.", "strength", 0.0, "1", _decide),
    AmbientOcclusion,
    "light",
    "posegaussian.stages.simulator.effects.ambient_occlusion:apply",
    18.0,
)
