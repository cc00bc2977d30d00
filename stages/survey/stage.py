"""Declaration of the survey stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, Facts
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.survey.algorithms.look import KEPT_PICTURES
from posegaussian.stages.survey.measures.declaration import Source
from posegaussian.stages.survey.measures.registry import MEASURES
from posegaussian.stages.survey.params import LONGEST, SurveyParams
from posegaussian.stages.survey.trust import TRUST
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: SurveyParams) -> Resources:
    """All sampled pictures of one view at once, with where people stand in them, a few pictures while one is
    decoded, and features of other views."""
    return Resources(
        cpu=1,
        ram=shape["source_y"] * shape["source_x"] * (4 * params.sample + 40)
        + min(KEPT_PICTURES, 2 * shape["view"]) * 2**22,
    )


def _looked_at(source: Source, params: SurveyParams, facts: Facts) -> bool:
    """Whether the capture has it and a measure that is asked for looks at it."""
    return source in facts and any(source in m.sources(params) for m in MEASURES if m.asked(facts))


def _joints(params: SurveyParams, facts: Facts) -> bool:
    return ESTIMATED not in facts and _looked_at("joints2d", params, facts)


def _estimator(params: SurveyParams, facts: Facts) -> bool:
    return ESTIMATED in facts and _looked_at("joints2d", params, facts)


def _joints3d(params: SurveyParams, facts: Facts) -> bool:
    return JOINTS2D not in facts and _looked_at("joints3d", params, facts)


def _masks(params: SurveyParams, facts: Facts) -> bool:
    return _looked_at("masks", params, facts)


STAGE = Stage(
    name="survey",
    summary="Take the measures and constants of a sequence from a recorded sample of frames.",
    version=14,
    run="posegaussian.stages.survey.run:run",
    check="posegaussian.stages.survey.run:check",
    reads=(
        Read.source("pictures", views="own"),
        Read.source("joints", views="all", when=_joints),
        Read.source("estimator", when=_estimator),
        Read.source("joints3d", when=_joints3d),
        Read.source("masks", views="sources", when=_masks),
    ),
    writes=(
        ArraySpec(
            "survey/sample",
            ("view", "sample"),
            "int64",
            "1",
            "Source frame numbers that measures were taken of; -1 pads.",
        ),
        *(array for m in MEASURES for array in m.arrays),
    ),
    over=("sequence", "view"),
    params=SurveyParams,
    needs=needs,
    typical=Typical(seconds=1.2e-7, ratio=0.5),
    unit=Unit(worked=0, captured=1),
    sequence_wide=True,
    cameras=lambda rig, params: frames_rig(rig, LONGEST),
    dimensions=lambda params, facts: {"sample": params.sample},
    trust=TRUST,
)
