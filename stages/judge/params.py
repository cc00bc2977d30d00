"""Settings of the judge stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Params, setting


class JudgeParams(Params):
    """How many pictures of left-out source views are judged, and how large they are."""

    frames: int = setting(
        2,
        "Frames, spread evenly over those that are worked on, whose source views are drawn.",
        unit="frames",
        ge=1,
        le=25,
    )
    views: int = setting(
        8,
        "Source views left out, one at a time, spread evenly over those that stand between two others, or over all"
        " where fewer than two do.",
        ge=1,
        le=64,
    )
    size: int = setting(384, "Longest side of the pictures that are drawn; never enlarges.", unit="px", ge=32, le=4096)
