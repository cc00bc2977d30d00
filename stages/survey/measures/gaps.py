"""What given masks hold beside the body that looks like the backdrop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/gaps"


class GapsLook(Look):
    """[2] of one view: share and doubt of `posegaussian.stages.frames.gaps.gaps_in`, means over a few frames; zeros of
    a view that is no source, and where no joints tell."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        from posegaussian.stages.detection.reader import joint_reader

        self.numbers = self.joints = s.if_source(s.few)
        self._joints, self._masks, self._view = joint_reader(s.inputs), s.inputs.source("masks"), s.view
        self._found: list[tuple[float, float]] = []

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """What one frame's mask fills."""
        from posegaussian.stages.frames.gaps import gaps_in

        (mask,) = self._masks.read(self._view, [number])
        if shown.shape[:2] != mask.shape:
            return
        found = gaps_in(shown, mask, self._joints.read(self._view, number), self._joints.joint_set)
        if found is not None:
            self._found.append((found.share, found.doubt))

    def blocks(self) -> Iterator[Block]:
        """How much, and how doubtful."""
        yield Block(NAME, np.mean(self._found, axis=0) if self._found else np.zeros(2), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "gap"),
            "float64",
            "1",
            "Share of a view's masks that lies beside the body and looks like the backdrop around them, and share of"
            " what is the body's for certain that does, means of 5 frames.",
            when=NAME,
            noted=True,
        ),
    ),
    GapsLook,
    of("masks", "joints2d"),
)
