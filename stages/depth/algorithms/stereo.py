"""Depth of all source views of one frame: hull, matching along it, mutual checks, and a second round along the
result."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.depth.algorithms.consensus import agreed
from posegaussian.stages.depth.algorithms.few_partners import Limbs, completed, searched, unmatched, with_few_partners
from posegaussian.stages.depth.algorithms.occluding_contour import turn_away
from posegaussian.stages.depth.algorithms.rows import in_rows
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps, depth_range, hulls
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.matching.bounds import IN_FRONT, Bounds, around
from posegaussian.stages.matching.sampling import beyond_silhouette
from posegaussian.stages.matching.sgbm import NARROW, WIDE

RESIDUAL = 0.012
"""Half width of the second round's search, px over the picture's longer side: 6 px at 512."""


def estimate(geometry: Geometry, frame: Frame, params: SearchSettings, checked: bool = True) -> Maps:
    """Depth and confidence by view: matched between the hull's bounds twice, the gaps completed.

    The second round follows the first one's result and searches a few px around it. Unless `checked`, a match counts
    whatever the other view says.
    """
    inside, found = frame.inside, hulls(geometry, frame)
    colors = {v: beyond_silhouette(c, inside[v]) for v, c in frame.colors.items()}
    few = with_few_partners(geometry, frame, found)
    bounds, limits = {}, {}
    for v, hull in found.items():
        bounds[v], limits[v] = searched(geometry, v, hull, geometry.inverse_depth(v, IN_FRONT), few)
    rest = unmatched(geometry, found, frame.flesh)
    first = _completed(in_rows(geometry, colors, inside, bounds, params, checked, WIDE), found, rest, few)
    again = {v: around(first[v][0], geometry.inverse_depth(v, RESIDUAL), *limits[v]) for v in found}
    last = _completed(in_rows(geometry, colors, inside, again, params, checked, NARROW), found, rest, few)
    return agreed(geometry, {v: turn_away(geometry.rig, v, *last[v], *found[v], inside[v]) for v in found}, found)


def estimate_open(geometry: Geometry, frame: Frame, params: SearchSettings, checked: bool = True) -> Maps:
    """Depth and confidence by view of pictures without silhouettes, where there is no hull.

    Searched is `params.depth_range`, or 0.6 to 2 times the distance of the point the cameras look at; a pixel without
    a match, or unless `checked` is False with one that does not hold in both directions, has depth 0.
    """
    inside, bounds = frame.inside, {}
    for v in geometry.views:
        near, far = depth_range(geometry, v, params)
        # The windows stand upright at the middle of the range.
        bounds[v] = Bounds(*(np.where(inside[v], z, 0).astype(np.float32) for z in ((near * far) ** 0.5, near, far)))
    return in_rows(geometry, frame.colors, inside, bounds, params, checked, WIDE)


def _completed(rounds: Maps, hulls: Maps, rest: dict[int, np.ndarray], few: dict[int, Limbs | None]) -> Maps:
    return {v: completed(rounds[v], hulls[v], rest[v], few.get(v)) for v in rounds}
