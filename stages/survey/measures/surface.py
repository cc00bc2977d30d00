"""How bright two cameras see the same surface points."""

from __future__ import annotations

from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec


def _look(s: Sampled) -> Look:
    from posegaussian.stages.survey.algorithms.surface import SurfaceLook

    return SurfaceLook(s.inputs, s.view, s.compared)


MEASURE = Measure(
    (
        ArraySpec(
            "survey/surface",
            ("view", "other_view", "point", "rgb"),
            "float32",
            "stops",
            "By how much a source view is brighter than each later one at up to 64 surface points that both show, the"
            " darkest first; 99 where there is none.",
            when="survey/surface",
            noted=True,
        ),
    ),
    _look,
    of("masks"),
)
