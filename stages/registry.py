"""The stages, in the order of flow."""

from __future__ import annotations

from stages.contract import Stage
from stages.depth.stage import STAGE as DEPTH
from stages.detection.stage import STAGE as DETECTION
from stages.frames.stage import STAGE as FRAMES
from stages.gaussians.stage import STAGE as GAUSSIANS
from stages.metrics.stage import STAGE as METRICS
from stages.network.stage import STAGE as NETWORK
from stages.pose.stage import STAGE as POSE
from stages.refinement.stage import STAGE as REFINEMENT
from stages.rendering.stage import STAGE as RENDERING
from stages.smoothing.stage import STAGE as SMOOTHING
from stages.survey.stage import STAGE as SURVEY

STAGES: tuple[Stage, ...] = (SURVEY, DETECTION, POSE, FRAMES, SMOOTHING, DEPTH, NETWORK, GAUSSIANS, REFINEMENT, RENDERING, METRICS)


def stage(name: str) -> Stage:
    """The stage of that name; KeyError lists the known ones."""
    for s in STAGES:
        if s.name == name:
            return s
    raise KeyError(f"no stage {name!r}; the stages are {', '.join(s.name for s in STAGES)}")
