"""A pose estimator is off by some pixels, more where a joint is hidden;
it misses joints, and now and then finds one elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator


class JointNoise(EffectParams):
    """How wrong."""

    pixels: float = Field(4.0, ge=0, le=500, description="Standard deviation, px; twice that where a joint is hidden.")
    dropouts: float = Field(0.05, ge=0, le=1, description="Share of the joints that are not found; their score is 0.")
    outliers: float = Field(0.01, ge=0, le=1, description="Share found elsewhere, ten times as far off.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p = evidence.params
    return above(
        max(p.pixels, p.dropouts, p.outliers),
        bound,
        f"joints are off by {p.pixels:g} px, {p.dropouts:.0%} are missed and {p.outliers:.0%} are elsewhere",
    )


def apply(joints: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Joints [17, 3] (u, v, score) as a pose estimator would give them; the score falls with the error it expects."""
    random = generator(seed, "joint_noise", shot.frame, shot.view)
    out = joints.copy()
    sigma = params.pixels * np.where(shot.visible, 1.0, 2.0)
    off, fate = random.normal(size=(len(out), 2)), random.random(len(out))
    outlier = (fate >= params.dropouts) & (fate < params.dropouts + params.outliers)
    out[:, :2] += off * (sigma * np.where(outlier, 10.0, 1.0))[:, None]
    out[:, 2] *= np.where(shot.visible, 0.9, 0.55) + 0.1 * random.random(len(out))
    out[fate < params.dropouts] = 0.0
    return out


EFFECT = SceneEffect(
    Effect("joint_noise", "Report joints as a pose estimator does.", "error of a joint", 0.0, "px", _decide),
    JointNoise,
    "joints",
    "posegaussian.stages.simulator.effects.joint_noise:apply",
    1.0,
)
