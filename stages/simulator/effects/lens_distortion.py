"""Glass bends rays: a point at radius r from the axis is pictured at r (1 + k1 r^2 + k2 r^4)
and off-axis by p1, p2 (Brown-Conrady)."""

from __future__ import annotations

import dataclasses
from typing import Any

from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above
from posegaussian.storage.model.cameras import Rig


class LensDistortion(EffectParams):
    """Coefficients as OpenCV orders them."""

    k1: float = Field(-0.08, ge=-1, le=1)
    k2: float = Field(0.0, ge=-1, le=1)
    p1: float = Field(0.0, ge=-0.1, le=0.1)
    p2: float = Field(0.0, ge=-0.1, le=0.1)


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p, r = evidence.params, 0.5  # the middle of an edge of a picture as wide as its focal length
    moved = evidence.picture * (abs(p.k1) * r**3 + abs(p.k2) * r**5 + 3 * r * r * max(abs(p.p1), abs(p.p2)))
    return above(moved, bound, f"the lens moves a point at the picture's edge by about {moved:.2f} px")


def apply(rig: Rig, params: Any, seed: int) -> Rig:
    """The rig with the lens in every camera: cameras as calibrated know it."""
    out = rig.distortion.copy()
    out[:, :4] = params.k1, params.k2, params.p1, params.p2
    return dataclasses.replace(rig, distortion=out)


EFFECT = SceneEffect(
    Effect(
        "lens_distortion", "Bend the rays as a lens does.", "displacement at the picture's edge", 0.05, "px", _decide
    ),
    LensDistortion,
    "rig",
    "posegaussian.stages.simulator.effects.lens_distortion:apply",
    7.0,
)
