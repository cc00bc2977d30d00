"""How much of an edge pictures have across the outlines of given masks, and have across redrawn ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/slopes"


class SlopesLook(Look):
    """[2] of one view: `posegaussian.stages.frames.outline_redrawing.slopes`, means over two frames; zeros of a view
    that is no source, and where a mask has no edge along it."""

    def __init__(self, s: Sampled) -> None:
        """Of two frames: how masks were made does not change over the take."""
        from posegaussian.stages.survey.algorithms.sample import compared_numbers

        self.numbers = compared_numbers(s.if_source(s.compared))
        self._masks, self._view = s.inputs.source("masks"), s.view
        self._found: list[tuple[float, float]] = []

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Along the outlines of one frame."""
        from posegaussian.stages.frames.outline_redrawing import slopes

        (mask,) = self._masks.read(self._view, [number])
        found = slopes(shown, mask) if shown.shape[:2] == mask.shape else None
        if found is not None:
            self._found.append(found)

    def blocks(self) -> Iterator[Block]:
        """As given, and redrawn."""
        yield Block(NAME, np.mean(self._found, axis=0) if self._found else np.zeros(2), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "slope"),
            "float64",
            "1/255 a px",
            "How much colours change across the outlines of a view's masks as they are given, moved to where pictures"
            " change most, and across outlines redrawn along the pictures' edges; means of their points, of 2 frames.",
            when=NAME,
            noted=True,
        ),
    ),
    SlopesLook,
    of("masks"),
)
