"""The third view of a pair: which one it is, and what of it the network is shown.

It is not rectified: a pair's rows mean nothing in it. It is shown on a window of its own picture, in pixels as fine as
those of the rectified pair, and a projection says where a pixel of either rectified view lies in it at a depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from posegaussian.stages.geometry.pairs import PairReport
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.rectification import RectifiedPair, Window
from posegaussian.stages.network.model.encoders import HEATMAP_CELL
from posegaussian.stages.network.model.pairs import MARGIN, SourceView, Third, colors_at, heatmaps_at, whole_cells
from posegaussian.stages.network.model.warping import projection
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres

LEAST = 4
"""Cells that a window is wide and high at least:
on fewer, results depend on the number of threads (`stages/network/model/encoders.py`)."""


def candidates(rig: Rig, pair: RectifiedPair, reports: Sequence[PairReport]) -> tuple[int, ...]:
    """Views that make a usable pair with either view of the pair, narrowest angle first, as `choose_pairs` takes
    partners.

    At equal angles, as on both sides of a pair of a ring, the one farther to the pair's left comes first and not the
    one of the lower index: so the order of the cameras does not matter. `reports` hold at least those of all such views
    with the pair's.
    """
    angles: dict[int, float] = {}
    for report in reports:
        outside = set(report.views) - set(pair.views)
        if report.usable and len(outside) == 1:
            view = outside.pop()
            angles[view] = min(angles.get(view, np.inf), round(report.angle, 1))
    across = np.round(rig.centres @ pair.rotation[0], 6)
    return tuple(sorted(angles, key=lambda v: (angles[v], across[v], v)))


def third_of(
    rig: Rig,
    pair: RectifiedPair,
    windows: tuple[Window, Window],
    views: Mapping[int, SourceView],
    multiple: int,
    joints: int,
) -> Third | None:
    """The first of the views, in their order, that shows a surface, on a window around it; None where none does.

    windows: those of the rectified pair; multiple: px that the sides of the third one are a multiple of.
    """
    for view, shown in views.items():
        window = window_around(shown.depth > 0, finer(rig, pair, view), multiple)
        if window is not None:
            return third_view(rig, pair, windows, view, shown, window, joints)
    return None


def finer(rig: Rig, pair: RectifiedPair, view: int) -> float:
    """Pixels of the third view's windows per pixel of its picture:
    what gives both the focal length of the rectified pair."""
    return pair.focal / float(rig.intrinsics[view][[0, 1], [0, 1]].mean())


def intrinsics_of(rig: Rig, pair: RectifiedPair, view: int, corner: tuple[int, int] = (0, 0)) -> np.ndarray:
    """[3, 3] of a view in pixels as fine as the pair's, counted from a corner (x0, y0) of these."""
    scale = finer(rig, pair, view)
    k = np.diag([scale, scale, 1.0]) @ rig.intrinsics[view]
    k[:2, 2] -= corner
    return k


def window_around(inside: np.ndarray, scale: float, multiple: int) -> Window | None:
    """Around what is wanted of a view, [h, w] bool, in pixels `scale` times as fine, with a margin;
    None where nothing is."""
    rows, columns = np.nonzero(inside)
    if not len(rows):
        return None
    places = scale * (np.stack([columns, rows], axis=-1) + pixel_centres((1, 1))[0, 0])
    low, high = np.floor(places.min(axis=0) - MARGIN).astype(int), np.ceil(places.max(axis=0) + MARGIN).astype(int)
    width, height = (whole_cells(max(int(n), LEAST * multiple), multiple) for n in high - low)
    return int(low[0]), int(low[1]), width, height


def third_view(
    rig: Rig,
    pair: RectifiedPair,
    windows: tuple[Window, Window],
    view: int,
    shown: SourceView,
    window: Window,
    joints: int,
) -> Third:
    """A view of the rig as the third of a pair, on a window of pixels as fine as the pair's,
    multiples of 4 px wide and high."""
    scale, corner = finer(rig, pair, view), np.array(window[:2])
    x, y = (
        np.ascontiguousarray(m)
        for m in np.moveaxis(
            points_to_integer_centres((pixel_centres(window[2:]) + corner) / scale).astype(np.float32), -1, 0
        )
    )
    color, _ = colors_at(shown, x, y)
    cells = pixel_centres((window[2] // HEATMAP_CELL, window[3] // HEATMAP_CELL))
    heatmaps = heatmaps_at(shown.heatmaps, (cells * HEATMAP_CELL + corner) / scale, joints)
    mine = intrinsics_of(rig, pair, view, window[:2])
    to = []
    for which in (0, 1):
        k = pair.intrinsics[which].copy()
        k[:2, 2] -= windows[which][:2]
        to.append(projection(k, pair.world_to_camera(which), mine, rig.world_to_camera[view]))
    return Third(torch.from_numpy(np.ascontiguousarray(color))[None], torch.from_numpy(heatmaps)[None], torch.stack(to))
