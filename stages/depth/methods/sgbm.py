"""Semi-global matching of rectified pairs, bounded by the hull where there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod

if TYPE_CHECKING:
    from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps


def _maps(geometry: Geometry, frame: Frame, params: SearchSettings, checked: bool) -> Maps:
    from posegaussian.stages.depth.algorithms.stereo import estimate, estimate_open

    return (estimate if geometry.silhouettes else estimate_open)(geometry, frame, params, checked)


METHOD = DepthMethod(
    "sgbm",
    "semi-global matching of rectified pairs, bounded by the hull",
    of_frame=_maps,
    reads=("frames/color",),
    several=True,
    matches=True,
    rectifies=True,
    quality=2,
    seconds=1.5,
)
