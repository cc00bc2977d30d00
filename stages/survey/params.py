"""Settings of the survey stage."""

from posegaussian.stages.contract.declaration import Params, setting

PLATE, SPREAD, COLORS, MOTION, SILHOUETTES, OUTLINES, JOINT_FIT, NOISE, LIGHT, SURFACE = (
    "survey/plate",
    "survey/spread",
    "survey/colors",
    "survey/motion",
    "survey/silhouettes",
    "survey/outlines",
    "survey/joint_fit",
    "survey/noise",
    "survey/light",
    "survey/surface",
)
"""Outputs that are made only when asked for."""
BACKGROUND = "survey/background"
"""The plate's frames, written with it."""

LONGEST = 512
"""Longer side, px, of the cameras in which masks and joints are compared, whatever `frames.size` says: results do
not hang on it."""

KEPT_PICTURES = 24
"""Pictures whose features a process keeps for its other views' tasks, some 3 MB each."""


class SurveyParams(Params):
    """How the sequence is sampled."""

    sample: int = setting(
        25,
        "Frames sampled evenly: measures from those that frames.range selects, the background plate from the whole"
        " source of each view.",
        unit="frames",
        ge=3,
        le=501,
    )
    joints_margin: float = setting(
        0.06,
        "Where joints are given, how far around limbs no background is learnt, as a share of the person's extent; 0"
        " takes a plain median.",
        ge=0,
        le=0.5,
    )
