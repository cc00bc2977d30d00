"""How noisy a camera's pictures are from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.imaging.noise import OCTAVES
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/unrest"


class UnrestLook(Look):
    """[4] of one view: the median of `noise.unrest` at every octave over a few pairs of consecutive frames; 0 of a view
    that is no source, and of one with a single frame."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames and those after them."""
        following = np.searchsorted(s.numbers, s.few) + 1
        kept = following < len(s.numbers)
        self._next = dict(zip(s.few[kept].tolist(), s.numbers[following[kept]].tolist(), strict=True))
        self._pictures: dict[int, np.ndarray] = {}
        self.numbers = s.if_source(np.unique([*self._next, *self._next.values()]).astype(np.int64))
        self._view = s.view

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Keep the picture until the pairs are complete."""
        self._pictures[number] = shown

    def blocks(self) -> Iterator[Block]:
        """The median."""
        from posegaussian.stages.survey.algorithms.noise import at_octaves, unrest

        seen = self._pictures
        found = [at_octaves(unrest, seen[a], seen[b]) for a, b in self._next.items() if a in seen and b in seen]
        yield Block(NAME, np.median(found, axis=0) if found else np.zeros(OCTAVES), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "octave"),
            "float64",
            "1/255",
            "Standard deviation of the pictures' noise from one frame to the next, sRGB, median of 5 pairs: as filmed,"
            " and reduced to a half, a quarter and an eighth.",
            when=NAME,
            noted=True,
        ),
    ),
    UnrestLook,
)
