"""A calibration is a measurement: the cameras that are written down are turned
and moved a little against those that filmed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator
from posegaussian.storage.model.cameras import Rig, rigid


class CalibrationErrorParams(EffectParams):
    """How far off the cameras are."""

    pixels: float = Field(
        0.3,
        ge=0,
        le=100,
        description="px a point is off in the picture, standard deviation a direction, by the wrong rotation.",
    )
    metres: float = Field(0.0, ge=0, le=1, description="Standard deviation of each camera's place.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p = evidence.params
    return above(
        max(p.pixels, 1000 * p.metres), bound, f"calibrations are off by {p.pixels:g} px and {1000 * p.metres:g} mm"
    )


def apply(rig: Rig, params: Any, seed: int) -> Rig:
    """The cameras as written down. A rotation by a about x or y moves the middle of the picture by a f px."""
    poses = rig.world_to_camera.copy()
    for v in range(len(rig)):
        random = generator(seed, "calibration_error", v)
        a = random.normal(size=3) * params.pixels / rig.intrinsics[v, 0, 0]
        turn = np.array([[1, -a[2], a[1]], [a[2], 1, -a[0]], [-a[1], a[0], 1]])
        centre = rig.centres[v] + random.normal(size=3) * params.metres
        rotation = rigid(turn @ rig.rotations[v], np.zeros(3))[:3, :3]
        poses[v] = rigid(rotation, -rotation @ centre)
    return dataclasses.replace(rig, world_to_camera=poses)


EFFECT = SceneEffect(
    Effect(
        "calibration_error",
        "Write down cameras that are a little off.",
        "displacement by the wrong calibration",
        0.0,
        "px or mm",
        _decide,
    ),
    CalibrationErrorParams,
    "calibration",
    "posegaussian.stages.simulator.effects.calibration_error:apply",
    0.0,
)
