"""Settings of the refinement stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import Facts

FEWEST = 3
"""Usable source views: one judges, and two teach."""
EVERY = 6.0
"""Pixels of which one keeps its Gaussian by default, of `VIEWS` views or more."""
VIEWS = 8
"""Fewer keep more, as many in all as so many would: tuning people of four and six cameras gain 0.0 to 0.2 dB (384 px).
Those of eight, every fourth of them: 0.03, for a quarter more time."""
LEAST = 2 / 3
"""Of those pixels, of very few views. Of two in nine, the SSIM of `balance` and `desk` from three cameras is .004 and
.005 less."""


class RefinementParams(Params):
    """How long each frame's Gaussians are optimised, and for how many frames that is found out at once."""

    steps: int = setting(
        200,
        "Most steps, each of a quarter of the source pictures, two at least; 0 leaves the stage out.",
        unit="steps",
        quality_levels=[0, 20, 50, 100, 200, 1000],
        ge=0,
        le=10000,
    )
    worth: float = setting(
        0.05,
        "What the left-out view's picture must gain in ten steps, on the mean of the last thirty, for more to be made;"
        " 0: any gain is worth it.",
        unit="dB",
        quality_levels=[0.2, 0.05, 0.0],
        ge=0,
        le=1,
    )
    every: float = setting(
        EVERY,
        "Pixels of which one keeps its Gaussian, of eight source views or more; of fewer views more do, as many in all,"
        " up to half as many again of each.",
        unit="px",
        quality_levels=[20.0, 10.0, 6.0, 4.0],
        ge=4,
        le=36,
    )
    group: int = setting(
        16,
        "Frames of a group, counted from the sequence's first, all of which are trained for as many steps as a"
        " rehearsal on its first one finds best, or on the next where it hardly gains; 1: every frame rehearses.",
        unit="frames",
        ge=1,
        le=64,
    )


COVERED = 0.6
"""Share of the pixels of all views that memory is projected for, nearly twice what the masks of `bust` cover: 0.32 of
its pictures on the mean, 0.42 of one at most."""


def pixels_a_gaussian(views: int, params: RefinementParams) -> float:
    """Of how many pixels of each of so many views one keeps its Gaussian."""
    return params.every * max(min(views / VIEWS, 1.0), LEAST)


def optimised_bytes(pixels: int, views: int, params: RefinementParams) -> int:
    """What optimising one frame takes, whose views have `pixels` each, `COVERED` of them with depth.

    Of those that keep one a Gaussian of fourteen numbers, with its gradient, the means of it, of its square and over
    steps, its ray, the lifted copy, and its slots in a picture's gradients; the pictures and their moments; the judge's
    picture of two views.
    """
    return int(pixels * (views / pixels_a_gaussian(views, params) * COVERED * 2224 + 760))


def halo(params: RefinementParams, facts: Facts) -> tuple[int, int]:
    """Frames before the partition that may have rehearsed for it."""
    return (params.group - 1, 0)
