"""Declaration of the survey stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Facts, Read, Resources, Stage
from posegaussian.stages.survey.params import (
    BACKGROUND,
    COLORS,
    JOINT_FIT,
    KEPT_PICTURES,
    LIGHT,
    LONGEST,
    MOTION,
    NOISE,
    OUTLINES,
    PLATE,
    SILHOUETTES,
    SPREAD,
    SURFACE,
    SurveyParams,
)
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: SurveyParams) -> Resources:
    """All sampled pictures of one view at once, with where people stand in them, a few pictures while one is
    decoded, and features of other views."""
    return Resources(
        cpu=1,
        ram=shape["source_y"] * shape["source_x"] * (4 * params.sample + 40)
        + min(KEPT_PICTURES, 2 * shape["view"]) * 2**22,
    )


def _joints(params: SurveyParams, facts: Facts) -> bool:
    return "detected" not in facts and _looks_at_joints(params, facts)


def _estimator(params: SurveyParams, facts: Facts) -> bool:
    return "detected" in facts and _looks_at_joints(params, facts)


def _looks_at_joints(params: SurveyParams, facts: Facts) -> bool:
    covered = bool(facts & {PLATE, SPREAD}) and params.joints_margin > 0
    return "joints2d" in facts and (covered or bool(facts & {COLORS, MOTION, JOINT_FIT}))


def _joints3d(params: SurveyParams, facts: Facts) -> bool:
    return "joints3d" in facts and "joints2d" not in facts and bool(facts & {COLORS, MOTION})


STAGE = Stage(
    name="survey",
    summary="Take the measures and constants of a sequence from a recorded sample of frames.",
    version=3,
    run="posegaussian.stages.survey.run:run",
    check="posegaussian.stages.survey.run:check",
    reads=(
        Read.source("pictures", views="own"),
        Read.source("joints", views="all", when=_joints),
        Read.source("estimator", when=_estimator),
        Read.source("joints3d", when=_joints3d),
        Read.source("masks", views="sources", when=lambda p, f: "masks" in f and bool(f & {SILHOUETTES, OUTLINES})),
    ),
    writes=(
        ArraySpec(
            "survey/sample",
            ("view", "sample"),
            "int64",
            "1",
            "Source frame numbers that measures were taken of; -1 pads.",
        ),
        ArraySpec(
            BACKGROUND,
            ("view", "sample"),
            "int64",
            "1",
            "Source frame numbers whose median is the plate; -1 pads.",
            when=PLATE,
        ),
        ArraySpec(
            PLATE,
            ("view", "source_y", "source_x", "rgb"),
            "uint8",
            "sRGB",
            "Median colour of the sample, people left out where joints tell: the background of a static camera, in"
            " captured pixels.",
            when=PLATE,
        ),
        ArraySpec(
            SPREAD,
            ("view", "source_y", "source_x"),
            "uint8",
            "1/255",
            "Median absolute deviation from the plate, largest of the three channels; 255: a person covered the pixel"
            " in nearly every frame.",
            when=SPREAD,
        ),
        ArraySpec(
            COLORS,
            ("view", "patch", "rgb"),
            "float32",
            "linear light",
            "Median colour of 192 patches of the body, the same in every source view (12 joints x 16 directions), 0..1;"
            " 0 where not seen.",
            when=COLORS,
            noted=True,
        ),
        ArraySpec(
            SURFACE,
            ("view", "other_view", "point", "rgb"),
            "float32",
            "stops",
            "By how much a source view is brighter than each later one at up to 64 surface points that both show, the"
            " darkest first; 99 where there is none.",
            when=SURFACE,
            noted=True,
        ),
        ArraySpec(
            MOTION,
            ("view", "motion"),
            "float64",
            "px",
            "Joint jitter (px), joint motion (px a source frame) in captured pixels, and how many joints were compared"
            " over four frames each.",
            when=MOTION,
            noted=True,
        ),
        ArraySpec(
            SILHOUETTES,
            ("view", "one"),
            "float64",
            "1",
            "Share of the rim of a view's masks that the other masks leave something of, mean of 5 frames; -1 where"
            " unknown.",
            when=SILHOUETTES,
            noted=True,
        ),
        ArraySpec(
            OUTLINES,
            ("view", "outline"),
            "float64",
            "px",
            "How far the outline of a view's masks lies outside the pictures' own edges, median and interquartile range"
            " in captured pixels, and how many points of 5 frames tell.",
            when=OUTLINES,
            noted=True,
        ),
        ArraySpec(
            JOINT_FIT,
            ("view", "fit"),
            "float64",
            "1",
            "How far a view's joints lie from the triangulated ones: the median and the share within 1.5 %, over the"
            " picture's longer side, and how many a frame tell, of 5 frames.",
            when=JOINT_FIT,
            noted=True,
        ),
        ArraySpec(
            LIGHT,
            ("view", "light"),
            "float64",
            "linear light",
            "Share of the pixels with a channel above white (1), and the 99.9th percentile of the pixels' largest"
            " channel, largest of 5 frames.",
            when=LIGHT,
            noted=True,
        ),
        ArraySpec(
            NOISE,
            ("view", "one"),
            "float64",
            "1/255",
            "Standard deviation of the pictures' noise, sRGB, median of 5 frames.",
            when=NOISE,
            noted=True,
        ),
    ),
    over=("sequence", "view"),
    params=SurveyParams,
    needs=needs,
    sequence_wide=True,
    longest=LONGEST,
)
