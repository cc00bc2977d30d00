"""How much of a camera's light lies beyond white."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/light"


class LightLook(Look):
    """[2] of one view: the largest of each of `light.light_beyond_white`; (0, 1) of a view that is no source."""

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        self.numbers, self._view, self._found = s.if_source(s.few), s.view, [np.array([0.0, 1.0])]

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Light of one frame."""
        from posegaussian.stages.survey.algorithms.light import light_beyond_white

        self._found.append(light_beyond_white(picture))

    def blocks(self) -> Iterator[Block]:
        """The brightest frame's."""
        yield Block(NAME, np.max(self._found[1:] or self._found, axis=0), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "light"),
            "float64",
            "linear light",
            "Share of the pixels with a channel above white (1), and the 99.9th percentile of the pixels' largest"
            " channel, largest of 5 frames.",
            when=NAME,
            noted=True,
        ),
    ),
    LightLook,
)
