"""Loose cloth lags behind the body and swings back:
each point follows the acceleration it would feel, as far as its slack allows."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class ClothMotion(EffectParams):
    """How loosely."""

    lag: float = Field(0.06, gt=0, le=1, description="Seconds that loose cloth is behind.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    moved = evidence.exposure_motion * evidence.params.lag * 30.0
    return above(moved, bound, f"in {evidence.params.lag:g} s the fastest joint moves {moved:.2f} px")


def _no_cloth(evidence: SceneEvidence) -> str | None:
    return None if evidence.person else "a scan has no loose cloth"


def apply(now: np.ndarray, before: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """now, before [V, 3] vertices at the moment and `lag` seconds earlier;
    slack [V] metres. Each lags by at most its slack."""
    behind = before - now
    length = np.linalg.norm(behind, axis=1)
    reach = slack * np.tanh(length / np.maximum(slack, 1e-9))
    return now + behind * (reach / np.maximum(length, 1e-12))[:, None]


EFFECT = SceneEffect(
    Effect(
        "cloth_motion",
        "Let loose cloth lag behind the body.",
        "motion within the lag",
        0.5,
        "px",
        _decide,
        lacks=_no_cloth,
    ),
    ClothMotion,
    "cloth",
    "posegaussian.stages.simulator.effects.cloth_motion:apply",
    4.0,
)
