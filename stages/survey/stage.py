"""Declaration of the survey stage."""

from __future__ import annotations

from stages.contract import Facts, Read, Resources, Stage
from stages.survey.params import SurveyParams
from storage.spec import ArraySpec, Shape


def needs(shape: Shape, params: SurveyParams) -> Resources:
    """All sampled pictures of one view at once, with where people stand in them, and a few pictures while one is decoded."""
    return Resources(cpu=1, ram=shape["source_y"] * shape["source_x"] * (4 * params.sample + 40))


def _joints(params: SurveyParams, facts: Facts) -> bool:
    return "joints2d" in facts and params.joints_margin > 0


STAGE = Stage(
    name="survey",
    summary="Take the measures and constants of a sequence from a recorded sample of frames.",
    version=1,
    run="stages.survey.run:run",
    check="stages.survey.run:check",
    reads=(Read.source("pictures", views="own"), Read.source("joints", views="own", when=_joints)),
    writes=(
        ArraySpec("survey/sample", ("view", "sample"), "int64", "1", "Source frame numbers that were looked at; -1 pads."),
        ArraySpec("survey/plate", ("view", "source_y", "source_x", "rgb"), "uint8", "sRGB", "Median colour of the sample, people left out where joints tell: the background of a static camera, in captured pixels."),
        ArraySpec("survey/spread", ("view", "source_y", "source_x"), "uint8", "1/255", "Median absolute deviation from the plate, largest of the three channels; 255: a person covered the pixel in nearly every frame."),
    ),
    over=("sequence", "view"),
    params=SurveyParams,
    needs=needs,
    sequence_wide=True,
)
