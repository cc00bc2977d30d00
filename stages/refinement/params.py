"""Settings of the refinement stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import Facts


class RefinementParams(Params):
    """How long each frame's Gaussians are optimised, and what a frame starts from."""

    steps: int = setting(
        0,
        "Most steps of two source pictures each; 0 leaves the stage out.",
        unit="steps",
        quality_levels=[0, 20, 50, 200, 1000],
        ge=0,
        le=10000,
    )
    group: int = setting(
        4,
        "Frames of a group, counted from the sequence's first: each but a group's first may start from what the one"
        " before it learnt; 1: every frame starts from its own Gaussians.",
        unit="frames",
        ge=1,
        le=64,
    )


def halo(params: RefinementParams, facts: Facts) -> tuple[int, int]:
    """Frames before the partition that a frame's group may reach back to."""
    return (params.group - 1, 0)
