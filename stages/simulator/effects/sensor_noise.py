"""Photons arrive one by one (variance = mean), and reading a pixel adds a noise of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator

_MID_GREY = 0.18
_SLOPE = 255 * 1.055 / 2.4 * _MID_GREY ** (1 / 2.4 - 1)
"""Steps of 8 bit a unit of light at mid-grey: the sRGB curve's slope there."""


class SensorNoise(EffectParams):
    """The sensor."""

    electrons: float = Field(
        6000.0, gt=0, le=1e7, description="Electrons that white gives in one exposure; fewer are noisier."
    )
    read: float = Field(6.0, ge=0, le=1e5, description="Standard deviation of reading, electrons.")


def _sigma(p: Any) -> float:
    return float(np.sqrt(_MID_GREY * p.electrons + p.read**2) / p.electrons * _SLOPE)


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    sigma = _sigma(evidence.params)
    return above(sigma, bound, f"mid-grey varies by {sigma:.2f} of 255 steps")


def apply(light: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Light [h, w, 3] linear with shot and read noise; the photon count's Poisson law is taken as a normal one of
    the same variance."""
    random = generator(seed, "sensor_noise", shot.frame, shot.view)
    variance = np.maximum(light, 0.0) / params.electrons + (params.read / params.electrons) ** 2
    return light + np.sqrt(variance).astype(np.float32) * random.standard_normal(light.shape, dtype=np.float32)


EFFECT = SceneEffect(
    Effect("sensor_noise", "Add photon and read noise.", "noise at mid-grey", 0.1, "steps of 255", _decide),
    SensorNoise,
    "sensor",
    "posegaussian.stages.simulator.effects.sensor_noise:apply",
    26.0,
)
