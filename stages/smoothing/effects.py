"""When heatmaps are smoothed over time: where the joints' noise outweighs the lag that smoothing costs."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import SEVERAL_FRAMES
from posegaussian.stages.pose.facts import POSE_HEATMAPS
from posegaussian.stages.smoothing import facts

LEAST = 0.1
"""px a frame, jitter or motion: below it a scene is still."""
FEWEST = 8
"""Joints compared in a view before its measure counts."""


def _smoothing(evidence: Evidence, bound: float) -> Decision | None:
    if "survey/motion" not in evidence.noted:
        return None
    jitter, motion, compared = evidence.noted["survey/motion"].T
    known = compared >= FEWEST
    if not known.any():
        return Decision(
            False, None, bound, "no joint is known in four consecutive frames often enough to tell jitter from motion"
        )
    noise, speed = float(np.median(jitter[known])), float(np.median(motion[known])) * evidence.stride
    if max(noise, speed) < LEAST:
        return Decision(
            False, 0.0, bound, f"the scene is still: joints move and jitter by less than {LEAST:g} px a frame"
        )
    ratio = noise / max(speed, LEAST)
    sentence = f"joints jitter by {noise:.2f} px and move by {speed:.2f} px a frame"
    if noise < LEAST:
        return Decision(False, ratio, bound, f"{sentence}; less than {LEAST:g} px of jitter is none")
    return Decision(bool(ratio > bound), ratio, bound, sentence)


def _nothing_to_smooth(evidence: Evidence) -> str | None:
    """Why there is nothing to blend."""
    if POSE_HEATMAPS not in evidence.facts:
        return "no heatmaps are drawn (pose_heatmaps is off)"
    return None if SEVERAL_FRAMES in evidence.facts else "the capture has a single frame"


TEMPORAL_SMOOTHING = Effect(
    facts.TEMPORAL_SMOOTHING,
    "Blend pose heatmaps with those of the frames before.",
    "joint jitter over motion",
    # With weight w of the current frame, blending two frames takes 2 w (1 - w) of the noise variance 2 s^2 away
    # and adds the squared lag (1 - w)^2 v^2; the gain outweighs the loss from s / v = sqrt((1 - w) / w) / 2 on,
    # 0.25 at the default w = 0.8.
    0.25,
    "px/px",
    _smoothing,
    asks=("survey/motion",),
    lacks=_nothing_to_smooth,
)
