"""Cameras store pictures as JPEG: blocks of 8 x 8 pixels lose their fine detail, colours more than brightness."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class Jpeg(EffectParams):
    """How strong."""

    quality: int = Field(85, ge=1, le=100, description="Quality as libjpeg counts it.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(
        100 - evidence.params.quality, bound, f"pictures were stored as JPEG of quality {evidence.params.quality}"
    )


def apply(color: np.ndarray, shot: Any, params: Any, seed: int) -> np.ndarray:
    """Color [h, w, 3] uint8 sRGB after it was stored and read again."""
    import cv2

    data = cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, params.quality])[1]
    read = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert read is not None, "OpenCV reads what it wrote"
    return np.ascontiguousarray(read[..., ::-1])


EFFECT = SceneEffect(
    Effect("jpeg", "Store the picture as JPEG in between.", "quality lost", 0.0, "of 100", _decide),
    Jpeg,
    "file",
    "posegaussian.stages.simulator.effects.jpeg:apply",
    5.0,
)
