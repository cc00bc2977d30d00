"""Settings of the survey stage."""

from stages.contract import Params, setting


class SurveyParams(Params):
    """How the sequence is sampled."""

    sample: int = setting(25, "Frames sampled evenly from the whole source of each view, whatever frames.range says.", unit="frames", ge=3, le=501)
