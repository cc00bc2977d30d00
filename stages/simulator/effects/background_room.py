"""A studio has a floor, a ceiling and walls: a box around rig and subject that lies behind it in every picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class BackgroundRoom(EffectParams):
    """Its size; cameras must stand inside."""

    side: float = Field(9.0, gt=1, le=200, description="Length of a wall, metres.")
    ceiling: float = Field(3.4, gt=1, le=100, description="Height, metres.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(
        evidence.params.side,
        bound,
        f"the subject stands in a room of {evidence.params.side:g} x {evidence.params.side:g} m",
    )


def apply(light: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Light [h, w, 3] linear, premultiplied: the room is seen through what the subject leaves free."""
    from posegaussian.stages.simulator.render.room import room_light

    return light + (1.0 - shot.cover[..., None]) * room_light(shot.centre, shot.directions, params.side, params.ceiling)


EFFECT = SceneEffect(
    Effect("background_room", "Film in a room instead of before black.", "side of the room", 0.0, "m", _decide),
    BackgroundRoom,
    "background",
    "posegaussian.stages.simulator.effects.background_room:apply",
    30.0,
)
