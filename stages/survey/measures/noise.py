"""How noisy a camera's pictures are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/noise"


class NoiseLook(Look):
    """[1] of one view: the median of `noise.noise_level`; 0 of a view that is no source."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        self.numbers, self._view, self._found = s.if_source(s.few), s.view, list[float]()

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Noise of one frame."""
        from posegaussian.stages.survey.algorithms.noise import noise_level

        self._found.append(noise_level(shown))

    def blocks(self) -> Iterator[Block]:
        """The median."""
        yield Block(NAME, np.array([np.median(self._found) if self._found else 0.0]), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "one"),
            "float64",
            "1/255",
            "Standard deviation of the pictures' noise, sRGB, median of 5 frames.",
            when=NAME,
            noted=True,
        ),
    ),
    NoiseLook,
)
