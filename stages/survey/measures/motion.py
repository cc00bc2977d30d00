"""What of the joints' movement is noise of the detector, and what is the person."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED
from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/motion"
FEWER = 3
"""One in so many of the sampled frames begins a run in which estimated joints' motion is measured: looking costs."""


class MotionLook(Look):
    """[3] of one view: `motion.jitter_and_motion`; zeros of a view that is no source."""

    def __init__(self, s: Sampled) -> None:
        """Of runs of frames; pictures are not looked at."""
        from posegaussian.stages.survey.algorithms.motion import run_starts

        self._inputs, self._view, self._is_source = s.inputs, s.view, s.is_source
        self._runs = run_starts(s.numbers, s.chosen if ESTIMATED not in s.inputs.facts else s.chosen[::FEWER])
        self.joints = s.if_source(np.concatenate([*self._runs, NO_FRAMES]))

    def blocks(self) -> Iterator[Block]:
        """Jitter, motion and how many joints tell."""
        from posegaussian.stages.survey.algorithms.joints import runs_of_joints
        from posegaussian.stages.survey.algorithms.motion import jitter_and_motion

        found = (
            jitter_and_motion(runs_of_joints(self._inputs, self._view, self._runs))
            if self._is_source
            else (0.0, 0.0, 0)
        )
        yield Block(NAME, np.array(found, dtype=np.float64), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "motion"),
            "float64",
            "px",
            "Joint jitter (px), joint motion (px a source frame) in captured pixels, and how many joints were compared"
            " over four frames each.",
            when=NAME,
            noted=True,
        ),
    ),
    MotionLook,
    of("joints2d", "joints3d"),
)
