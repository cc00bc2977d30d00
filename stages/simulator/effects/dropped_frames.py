"""A camera that cannot write fast enough leaves frames out, each of them independently."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator


class DroppedFrames(EffectParams):
    """How often."""

    share: float = Field(0.02, ge=0, le=0.9, description="Share of the pictures that are missing.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    return above(evidence.params.share, bound, f"{evidence.params.share:.0%} of the pictures are missing")


def apply(times: np.ndarray, valid: np.ndarray, params: Any, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [F, V] s as they are; valid [F, V] without the dropped ones; the first frame of every camera stays."""
    drawn = np.array(
        [[generator(seed, "dropped_frames", f, v).random() for v in range(valid.shape[1])] for f in range(len(valid))]
    )
    kept = drawn >= params.share
    kept[0] = True
    return times, valid & kept


EFFECT = SceneEffect(
    Effect(
        "dropped_frames",
        "Leave out pictures that a camera failed to write.",
        "share of missing pictures",
        0.0,
        "1",
        _decide,
    ),
    DroppedFrames,
    "times",
    "posegaussian.stages.simulator.effects.dropped_frames:apply",
    0.0,
)
