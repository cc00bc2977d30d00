"""Settings of the smoothing stage."""

from __future__ import annotations

from typing import Literal

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import Facts


class SmoothingParams(Params):
    """Which filter, and how much of the current frame it keeps."""

    method: Literal["pairwise", "recurrent", "adaptive"] = setting(
        "pairwise",
        "pairwise: the paper's two-frame blend; recurrent: a truncated exponential filter; adaptive: pairwise with"
        " omega going to 1 with joint speed.",
    )
    omega: float = setting(0.8, "Weight of the current frame; 1 is the identity.", ge=0, le=1)
    truncation: int = setting(
        8,
        "Frames of the past that the recurrent filter looks at.",
        unit="frames",
        quality_levels=[2, 4, 8],
        ge=1,
        le=64,
    )
    speed: float = setting(
        1.0,
        "Joint displacement per frame, in heatmap sigmas, from which on the adaptive filter keeps only the current"
        " frame; up to 2 no second peak can appear.",
        unit="sigma",
        gt=0,
        le=2,
    )


def halo(params: SmoothingParams, facts: Facts) -> tuple[int, int]:
    """Frames before the partition that a filter looks at."""
    return (params.truncation if params.method == "recurrent" else 1, 0)
