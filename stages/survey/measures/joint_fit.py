"""How well a view's joints fit the triangulated ones."""

from __future__ import annotations

from collections.abc import Iterator

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/joint_fit"


class JointFitLook(Look):
    """[3] of one view: `joints.fit_of_view`."""

    def __init__(self, s: Sampled) -> None:
        """Of the joints of all source views; pictures are not looked at."""
        self._sampled, self.joints_of_all = s, s.few

    def blocks(self) -> Iterator[Block]:
        """Distance, share that fits, and how many joints tell."""
        from posegaussian.stages.survey.algorithms.joints import fit_of_view

        s = self._sampled
        yield Block(NAME, fit_of_view(s.inputs, s.view, s.few), s.view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "fit"),
            "float64",
            "1",
            "How far a view's joints lie from the triangulated ones: the median and the share within 1.5 %, over the"
            " picture's longer side, and how many a frame tell, of those of 5 frames that have any.",
            when=NAME,
            noted=True,
        ),
    ),
    JointFitLook,
    of("joints2d"),
)
