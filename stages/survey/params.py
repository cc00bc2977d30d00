"""Settings of the survey stage."""

from stages.contract import Params, setting

PLATE, SPREAD, COLORS, MOTION, SILHOUETTES, OUTLINES, JOINT_FIT, NOISE, LIGHT, SURFACE = "survey/plate", "survey/spread", "survey/colors", "survey/motion", "survey/silhouettes", "survey/outlines", "survey/joint_fit", "survey/noise", "survey/light", "survey/surface"
"""Outputs that are made only when asked for."""

NONE = 99.0
"""Stops where two cameras share no surface point."""


class SurveyParams(Params):
    """How the sequence is sampled."""

    sample: int = setting(25, "Frames sampled evenly from the whole source of each view, whatever frames.range says.", unit="frames", ge=3, le=501)
    joints_margin: float = setting(0.06, "Where joints are given, how far around limbs no background is learnt, as a share of the person's extent; 0 takes a plain median.", ge=0, le=0.5)
