"""Settings of the survey stage."""

from posegaussian.stages.contract.declaration import Params, setting

LONGEST = 512
"""Longer side, px, of the cameras in which masks and joints are compared, whatever `frames.size` says: results do
not hang on it."""


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
