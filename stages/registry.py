"""The stages, in the order of flow."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Asset, Paths, Stage, Undistorted
from posegaussian.stages.contract.trust import Trust
from posegaussian.stages.depth.stage import STAGE as DEPTH
from posegaussian.stages.detection.stage import STAGE as DETECTION
from posegaussian.stages.frames.stage import STAGE as FRAMES
from posegaussian.stages.gaussians.stage import STAGE as GAUSSIANS
from posegaussian.stages.judge.stage import STAGE as JUDGE
from posegaussian.stages.metrics.stage import STAGE as METRICS
from posegaussian.stages.network.stage import STAGE as NETWORK
from posegaussian.stages.people.stage import STAGE as PEOPLE
from posegaussian.stages.pose.stage import STAGE as POSE
from posegaussian.stages.refinement.stage import STAGE as REFINEMENT
from posegaussian.stages.rendering.stage import STAGE as RENDERING
from posegaussian.stages.smoothing.stage import STAGE as SMOOTHING
from posegaussian.stages.survey.stage import STAGE as SURVEY
from posegaussian.stages.tracks.stage import STAGE as TRACKS

STAGES: tuple[Stage, ...] = (
    SURVEY,
    JUDGE,
    DETECTION,
    TRACKS,
    PEOPLE,
    POSE,
    FRAMES,
    SMOOTHING,
    DEPTH,
    NETWORK,
    GAUSSIANS,
    REFINEMENT,
    RENDERING,
    METRICS,
)

PATHS: Paths = next(s.paths for s in STAGES if s.paths is not None)
"""How camera paths are made."""
TRUST: Trust = next(s.trust for s in STAGES if s.trust is not None)
"""How it is decided which cameras are believed."""
UNDISTORTED: Undistorted = next(s.undistorted for s in STAGES if s.undistorted is not None)
"""How far pictures reach once lenses are undone."""
ASSETS: dict[str, tuple[Stage, Asset]] = {asset.name: (s, asset) for s in STAGES for asset in s.assets}
"""Models and weights by the source that they are read as, each with the stage whose settings name it."""


def stage(name: str) -> Stage:
    """The stage of that name; KeyError lists the known ones."""
    for s in STAGES:
        if s.name == name:
            return s
    raise KeyError(f"no stage {name!r}; the stages are {', '.join(s.name for s in STAGES)}")
