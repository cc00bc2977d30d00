"""How source cameras stand by their silhouettes or, without masks, by joints: which are turned, and which are wrong."""

from __future__ import annotations

from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

STANDING = "survey/standing"


def _look(s: Sampled) -> Look:
    from posegaussian.stages.survey.standing.standing import StandingLook

    return StandingLook(STANDING, s.inputs, s.view)


MEASURE = Measure(
    (
        ArraySpec(
            STANDING,
            ("view", "standing"),
            "float64",
            "1",
            "How a source view stands by its silhouette or by joints: rad by which it is turned about its own axes, by"
            " how much of the longer side it contradicts the others as it is written down, and 1 where no turn mends"
            " that, 2 where it would stand right in the place of the other one of which this is so, 3 where joints told"
            " it, 4 where it was moved by that turn in mid-take, between the two source frames that come last, 5 where"
            " it would stand right if its pictures were mirrored, 6 where it stands right and its masks lack something"
            " that those of the others have, 7 where it is late by as many frames as come next, and 8 where its"
            " joints would lie right if its pictures were turned by 180 degrees.",
            when=STANDING,
            noted=True,
        ),
    ),
    _look,
    of("masks", "joints2d"),
)
