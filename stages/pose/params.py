"""Settings of the pose stage."""

from __future__ import annotations

from typing import Literal

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import ESTIMATED, Facts
from posegaussian.stages.pose.facts import POSE_HEATMAPS


class PoseParams(Params):
    """How joints are believed, and how wide a heatmap's peak is."""

    joints_frame: Literal["video", "calibrated"] = setting(
        "video",
        "Pixels that given joints refer to: the captured video's, or the calibrated picture's (after frames.crop).",
    )
    subject: str = setting(
        "largest",
        "Who is reconstructed of several people: largest (presence times size), central, or one of them: person1, ...",
        pattern=r"^(largest|central|(person)?[1-9][0-9]?)$",
    )
    min_score: float = setting(0.2, "Detections below this score are not triangulated.", ge=0, le=1)
    max_residual: float = setting(
        0.02,
        "Reprojection error above which a view's detection is an outlier, as a share of the picture's longest side, or"
        " of five times the person's extent in it where that is less.",
        gt=0,
        le=0.5,
    )
    bridge: int = setting(
        6,
        "Frames on either side whose joints bridge an occlusion and tell left from right; 0: every frame by itself.",
        unit="frames",
        quality_levels=[0, 3, 6, 12],
        ge=0,
        le=64,
    )
    sigma: float = setting(0.04, "Standard deviation of a joint's Gaussian.", unit="m, or px with sigma_unit: px", gt=0)
    sigma_unit: Literal["m", "px"] = setting(
        "m", "Whether sigma is in metres around the 3D joint or in pixels of the full-size picture."
    )
    heatmaps: Literal["model", "drawn"] = setting(
        "model", "Heatmaps of estimated joints: the estimator's own, or a Gaussian at each joint as for given ones."
    )


def uses_model_maps(params: PoseParams, facts: Facts) -> bool:
    """Whether the estimator's own heatmaps are used."""
    return params.heatmaps == "model" and {ESTIMATED, POSE_HEATMAPS} <= facts


def swap_reach(params: PoseParams) -> int:
    """Frames on either side that vote on left and right: half of those that bridge, rounded up."""
    return (params.bridge + 1) // 2


def halo(params: PoseParams, facts: Facts) -> tuple[int, int]:
    """Frames around the partition whose joints are read: those that bridge it, and those that vote on their sides."""
    reach = params.bridge + swap_reach(params)
    return reach, reach
