"""The survey's measures. A further one is a file of this folder and its entry here."""

from __future__ import annotations

from posegaussian.stages.survey.measures.agreement import MEASURE as AGREEMENT
from posegaussian.stages.survey.measures.contrast import MEASURE as CONTRAST
from posegaussian.stages.survey.measures.declaration import Measure
from posegaussian.stages.survey.measures.gaps import MEASURE as GAPS
from posegaussian.stages.survey.measures.joint_fit import MEASURE as JOINT_FIT
from posegaussian.stages.survey.measures.joint_scores import MEASURE as JOINT_SCORES
from posegaussian.stages.survey.measures.light import MEASURE as LIGHT
from posegaussian.stages.survey.measures.motion import MEASURE as MOTION
from posegaussian.stages.survey.measures.noise import MEASURE as NOISE
from posegaussian.stages.survey.measures.outlines import MEASURE as OUTLINES
from posegaussian.stages.survey.measures.plate import MEASURE as PLATE
from posegaussian.stages.survey.measures.slopes import MEASURE as SLOPES
from posegaussian.stages.survey.measures.standing import MEASURE as STANDING
from posegaussian.stages.survey.measures.surface import MEASURE as SURFACE
from posegaussian.stages.survey.measures.unrest import MEASURE as UNREST

MEASURES: tuple[Measure, ...] = (
    STANDING,
    AGREEMENT,
    CONTRAST,
    PLATE,
    SURFACE,
    OUTLINES,
    SLOPES,
    GAPS,
    LIGHT,
    NOISE,
    UNREST,
    MOTION,
    JOINT_FIT,
    JOINT_SCORES,
)
"""In the order in which they are taken of a view."""
