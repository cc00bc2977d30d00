"""How well a source view agrees with the others: whether what both see lies on the calibration's lines."""

from __future__ import annotations

from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/agreement"


def _look(s: Sampled) -> Look:
    from posegaussian.stages.survey.algorithms.agreement import AgreementLook

    return AgreementLook(NAME, s.inputs, s.view, s.chosen)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "other_view", "kind", "told"),
            "float32",
            "1",
            "By how much what a source view and each later one see misses the other's epipolar line, by features,"
            " outlines and joints: median beyond a captured px, share of the longer side; last the share of its"
            " foreground that each other mask alone carves away, at its own place all; and how many tell.",
            when=NAME,
            noted=True,
        ),
    ),
    _look,
    of("joints2d", "masks"),
)
