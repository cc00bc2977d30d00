"""Whether given masks end where the subject ends."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/outlines"


class OutlinesLook(Look):
    """[3] of one view: `outlines.outline_offset`; zeros of a view that is no source."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        self.numbers, self._masks, self._view = s.if_source(s.few), s.inputs.source("masks"), s.view
        self._found: list[np.ndarray] = []

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Where pictures change along the outline in one frame."""
        from posegaussian.stages.survey.algorithms.outlines import change_at_outline

        (mask,) = self._masks.read(self._view, [number])
        self._found.append(change_at_outline(shown, mask))

    def blocks(self) -> Iterator[Block]:
        """By how much the outline is off, and how surely."""
        from posegaussian.stages.survey.algorithms.outlines import outline_offset

        yield Block(NAME, outline_offset(self._found), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "outline"),
            "float64",
            "px",
            "How far the outline of a view's masks lies outside the pictures' own edges, and how far that scatters from"
            " point to point (interquartile range), in captured pixels, and how many points of 5 frames tell.",
            when=NAME,
            noted=True,
        ),
    ),
    OutlinesLook,
    of("masks"),
)
