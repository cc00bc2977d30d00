"""How well a source view agrees with the others: whether what both see lies on the calibration's lines."""

from __future__ import annotations

from posegaussian.stages.imaging.small_turns import LINKS
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/agreement"


def _look(s: Sampled) -> Look:
    from posegaussian.stages.survey.algorithms.agreement import AgreementLook

    return AgreementLook((NAME, LINKS), s.inputs, s.view, s.compared)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "other_view", "kind", "told"),
            "float32",
            "1",
            "By how much what a source view and each later one see misses the other's epipolar line, by features,"
            " outlines and joints: median beyond a captured px, share of the longer side; and how many tell.",
            when=NAME,
            noted=True,
        ),
        ArraySpec(
            LINKS,
            ("view", "other_view", "link", "two_xy"),
            "float32",
            "1",
            "What a source view and each later one both see, at most twelve outermost points of outlines, then twelve"
            " features: x and y at z = 1 in the axes of the one camera and of the other; 0 where there is none.",
            when=LINKS,
            noted=True,
        ),
    ),
    _look,
    of("joints2d", "masks"),
)
