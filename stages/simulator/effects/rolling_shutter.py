"""A sensor is read row by row: the last row shows a later moment than the first."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class RollingShutter(EffectParams):
    """How slowly."""

    readout: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Share of the frame interval from the first row to the last; the middle row is in time.",
    )


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    moved = evidence.params.readout * evidence.exposure_motion
    return above(moved, bound, f"between the first and the last row the fastest joint moves {moved:.2f} px")


def apply(params: Any, interval: float) -> float:
    """Seconds from the first row to the last."""
    return float(params.readout * interval)


EFFECT = SceneEffect(
    Effect("rolling_shutter", "Read the sensor row by row.", "motion while the sensor is read", 0.5, "px", _decide),
    RollingShutter,
    "rows",
    "posegaussian.stages.simulator.effects.rolling_shutter:apply",
    9.0,
)
