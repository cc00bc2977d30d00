"""Offsets from the hull, or from a range of depths, compared with several neighbours at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posegaussian.stages.contract.facts import SINGLE_SOURCE, Facts
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod

if TYPE_CHECKING:
    from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps


def _maps(geometry: Geometry, frame: Frame, params: SearchSettings, checked: bool) -> Maps:
    from posegaussian.stages.depth.algorithms.sweeping import sweep_hull, sweep_open

    return (sweep_hull if geometry.silhouettes else sweep_open)(geometry, frame, params, checked)


def _auto(facts: Facts) -> str | None:
    if SINGLE_SOURCE in facts:
        return None
    return (
        "no depth maps came with the capture; of the methods that match source views it drew the best pictures on the"
        " mean over every set that was measured"
    )


METHOD = DepthMethod(
    "sweep",
    "offsets from the visual hull, compared with several neighbours at once and along the rows of rectified pairs",
    of_frame=_maps,
    reads=("frames/color",),
    auto=_auto,
    several=True,
    matches=True,
    quality=3,
    seconds=0.9,
)
