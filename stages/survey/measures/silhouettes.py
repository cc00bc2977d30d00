"""Whether the masks of different views fit together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/silhouettes"


class SilhouettesLook(Look):
    """[1] of one view: `silhouettes.agreement_of_view`."""

    def __init__(self, s: Sampled) -> None:
        """Of the masks alone."""
        self._sampled = s

    def blocks(self) -> Iterator[Block]:
        """The share on which the masks agree."""
        from posegaussian.stages.survey.algorithms.silhouettes import agreement_of_view

        s = self._sampled
        yield Block(NAME, np.array([agreement_of_view(s.inputs, s.view, s.chosen)]), s.view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "one"),
            "float64",
            "1",
            "Share of the rim of a view's masks that the other masks leave something of, mean of 5 frames; -1 where"
            " unknown.",
            when=NAME,
            noted=True,
        ),
    ),
    SilhouettesLook,
    of("masks"),
)
