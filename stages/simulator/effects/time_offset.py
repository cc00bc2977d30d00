"""Cameras without a common trigger open their shutters at times that differ by a constant each."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator


class TimeOffset(EffectParams):
    """How far apart."""

    frames: float = Field(
        0.3, ge=0, le=100, description="Standard deviation of every camera's delay, in frame intervals."
    )


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    moved = evidence.params.frames * evidence.exposure_motion
    return above(moved, bound, f"in {evidence.params.frames:g} frame intervals the fastest joint moves {moved:.2f} px")


def apply(times: np.ndarray, valid: np.ndarray, params: Any, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [F, V] s with each camera's delay; valid as it is."""
    interval = times[1, 0] - times[0, 0] if len(times) > 1 else 1 / 30
    delay = (
        np.array([generator(seed, "time_offset", v).normal() for v in range(times.shape[1])]) * params.frames * interval
    )
    return times + delay, valid


EFFECT = SceneEffect(
    Effect("time_offset", "Film with cameras that are not in step.", "motion within the delay", 0.05, "px", _decide),
    TimeOffset,
    "times",
    "posegaussian.stages.simulator.effects.time_offset:apply",
    0.0,
)
