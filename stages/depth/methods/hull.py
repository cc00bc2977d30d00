"""The surface of the visual hull, which no picture has a say in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod

if TYPE_CHECKING:
    from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps


def _maps(geometry: Geometry, frame: Frame, params: SearchSettings, checked: bool) -> Maps:
    from posegaussian.stages.depth.algorithms.scene import hull_only

    return hull_only(geometry, frame)


METHOD = DepthMethod("hull", "the hull's surface alone", of_frame=_maps, several=True, quality=1, seconds=0.3)
