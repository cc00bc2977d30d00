"""Whether a camera's pictures show anything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

CONTRAST = "survey/contrast"
UNKNOWN = -1.0
"""Of a view whose masks are empty."""


class ContrastLook(Look):
    """A number of one view: the median of `contrast.contrast`; 0 of a view that is no source."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        self.numbers, self._view, self._found = s.if_source(s.few), s.view, list[float]()
        self._masks = s.inputs.source("masks") if MASKS in s.inputs.facts else None
        self._nothing = UNKNOWN if s.is_source else 0.0

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Contrast of one frame, inside its mask and around it."""
        from posegaussian.stages.imaging.contrast import contrast

        mask = next(iter(self._masks.read(self._view, [number]))) if self._masks is not None else None
        found = contrast(shown, mask)
        self._found += [found] if found is not None else []

    def blocks(self) -> Iterator[Block]:
        """The median."""
        yield Block(CONTRAST, np.array(np.median(self._found) if self._found else self._nothing), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            CONTRAST,
            ("view",),
            "float64",
            "1/255",
            "By how much a view's pictures vary in brightness, sRGB, where there are masks inside them or, if that is"
            " more, in the box around them: median of 5 frames; -1 where masks are empty.",
            when=CONTRAST,
            noted=True,
        ),
    ),
    ContrastLook,
    of("masks"),
)
