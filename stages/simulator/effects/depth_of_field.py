"""A lens of aperture A focused at distance s blurs a point at z into a disc of diameter f A |1/z - 1/s| px."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class DepthOfField(EffectParams):
    """The aperture and the focus."""

    aperture: float = Field(0.02, gt=0, le=1, description="Diameter of the aperture, metres.")
    focus: float | None = Field(None, gt=0, description="Distance in focus, metres; null: the subject's axis.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    near, far = 2.2, 2.6  # a hand in front of a subject in focus
    disc = evidence.picture * evidence.params.aperture * (1 / near - 1 / far)
    return above(disc, bound, f"0.4 m out of focus a point becomes a disc of {disc:.2f} px")


def apply(light: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Light [h, w, 3] linear with every point spread over its disc; what lies behind all surfaces is as far as 6 m."""
    from posegaussian.stages.simulator.render.defocus import spread

    focus = params.focus or shot.axis_distance
    depth = np.where(shot.first_depth > 0, shot.first_depth, 6.0)
    return spread(
        np.ascontiguousarray(light),
        (shot.focal * params.aperture * np.abs(1.0 / depth - 1.0 / focus) / 2.0).astype(np.float32),
    )


EFFECT = SceneEffect(
    Effect("depth_of_field", "Blur what is out of focus.", "disc of a point out of focus", 0.5, "px", _decide),
    DepthOfField,
    "optics",
    "posegaussian.stages.simulator.effects.depth_of_field:apply",
    37.0,
)
