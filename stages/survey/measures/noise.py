"""How noisy a camera's pictures are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.imaging.noise import OCTAVES
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/noise"


class NoiseLook(Look):
    """[4] of one view: the median of `noise.noise_level` at every octave; 0 of a view that is no source.

    Texture that becomes finer than a few pixels by being reduced passes for noise: reduced pictures count as having no
    more of it than those as filmed.
    """

    def __init__(self, s: Sampled) -> None:
        """Of a few frames."""
        self.numbers, self._view, self._found = s.if_source(s.few), s.view, list[np.ndarray]()

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Noise of one frame."""
        from posegaussian.stages.survey.algorithms.noise import at_octaves, noise_level

        found = at_octaves(noise_level, shown)
        self._found.append(np.minimum(found, found[0]))

    def blocks(self) -> Iterator[Block]:
        """The median."""
        yield Block(NAME, np.median(self._found, axis=0) if self._found else np.zeros(OCTAVES), self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "octave"),
            "float64",
            "1/255",
            "Standard deviation of the pictures' noise, sRGB, median of 5 frames: as filmed, and reduced to a half, a"
            " quarter and an eighth.",
            when=NAME,
            noted=True,
        ),
    ),
    NoiseLook,
)
