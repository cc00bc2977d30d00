"""How sure a view is of each joint."""

from __future__ import annotations

from collections.abc import Iterator

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/joint_scores"


class JointScoresLook(Look):
    """[17] of one view: `joints.scores_of_view`."""

    def __init__(self, s: Sampled) -> None:
        """Of the joints of all source views; pictures are not looked at."""
        self._sampled, self.joints_of_all = s, s.few

    def blocks(self) -> Iterator[Block]:
        """The mean score of every joint."""
        from posegaussian.stages.survey.algorithms.joints import scores_of_view

        s = self._sampled
        yield Block(NAME, scores_of_view(s.inputs, s.view, s.few), s.view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "coco17"),
            "float64",
            "1",
            "A view's mean score of each joint over those of 5 frames in which views agree on any, 0 where it does not"
            " find it.",
            when=NAME,
            noted=True,
        ),
    ),
    JointScoresLook,
    of("joints2d"),
)
