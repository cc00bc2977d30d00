"""Do the silhouettes of several views fit together? A foreground pixel is explained when somewhere along its ray no
other view sees background.

A silhouette that is wrong as a whole (shifted, another moment, another camera) carves the subject away in all other
views. It is found because the others explain each other once it is left out. All rays are walked once: a point that a
single view carves would be explained without that view.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.march import (
    MOST_POINTS,
    WITNESSES,
    beside,
    in_sphere,
    into_views,
    nearest_to,
    watched,
)
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres
from posegaussian.storage.model.masks import foreground

RAYS = 400
"""Rays of a view that are walked, about."""
STEP = 2.0
"""Px from one point of a ray to the next."""
TOLERANCE = 2.5
"""Px by which a point may lie outside a silhouette:
more than the step, and than what good calibrations and masks are off."""
LEAST = 0.05
"""Share of unexplained pixels from which on a silhouette is suspected."""
RELIEF = 0.5
"""A silhouette is left out where at most this share of what the others cannot explain remains without it."""
FEWEST = 4
"""Views among which one can be told to be wrong."""


@dataclass(frozen=True)
class Agreement:
    """What the silhouettes of a frame say about each other."""

    carving: frozenset[int]
    """Views whose silhouettes fit the others'."""
    unexplained: dict[int, float]
    """Share of each view's foreground that the others' silhouettes contradict, of those that carve."""

    @property
    def worst(self) -> float:
        """Largest unexplained share of a view."""
        return max(self.unexplained.values(), default=0.0)


def agreement(rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes) -> Agreement:
    """Of masks [h, w] uint8 by view index and what was prepared of them; at most one view is left out.

    A view is left out where the others hold `LEAST` of unexplained foreground and leaving it out explains most of it.
    A mask with too much foreground carves nothing and stays; its own share tells.
    """
    shares = {v: unexplained(rig, v, masks[v], silhouettes) for v in silhouettes.views}
    everything = {v: s[-1] for v, s in shares.items()}
    views = silhouettes.views
    if len(views) < FEWEST:
        return Agreement(frozenset(views), everything)

    def of_others(left_out: int, without: bool) -> float:
        return float(np.mean([s[views.index(left_out) if without else -1] for v, s in shares.items() if v != left_out]))

    relief = {v: of_others(v, True) - of_others(v, False) for v in views}
    suspect = min(relief, key=lambda v: (relief[v], v))
    before = of_others(suspect, False)
    if before < LEAST or of_others(suspect, True) > RELIEF * before:
        return Agreement(frozenset(views), everything)
    return Agreement(
        frozenset(views) - {suspect},
        {v: float(s[-1] if v == suspect else s[views.index(suspect)]) for v, s in shares.items()},
    )


def unexplained(rig: Rig, view: int, mask: np.ndarray, silhouettes: Silhouettes) -> np.ndarray:
    """[S + 1] share of a view's foreground that is not explained without each of the S views,
    and (last) with all of them."""
    inside = foreground(mask[: rig.size[view, 1], : rig.size[view, 0]])
    pixels = np.flatnonzero(inside)
    rows, columns = np.divmod(pixels[:: max(1, len(pixels) // RAYS)], inside.shape[1])
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)),
        rig.intrinsics[view],
        rig.world_to_camera[view],
    )
    s, (others, sides) = silhouettes, silhouettes.asked(origin, view)
    # Most rays are explained by all, which the hull's march, from silhouette to silhouette, finds ten times sooner.
    by_all = s.met(origin, directions, TOLERANCE, without=view)
    found = np.ones((len(directions), len(s.views) + 1), bool)
    found[~by_all] = _explained(
        origin,
        directions[~by_all],
        others,
        sides,
        s.distance,
        s.projections,
        s.sizes,
        s.focals,
        s.centre,
        s.radius,
        STEP * s.pixel,
    )
    return 1 - found.mean(axis=0)


@compiled
def _explained(
    origin: np.ndarray,
    directions: np.ndarray,
    others: np.ndarray,
    sides: int,
    distance: np.ndarray,
    projections: np.ndarray,
    sizes: np.ndarray,
    focals: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
) -> np.ndarray:
    """[N, S + 1] bool: whether a ray has a point that nobody but view s carves, and (last) that nobody carves, of which
    the first `sides` of the `others` look from the side; `pixel` metres a step."""
    count = projections.shape[0]
    out = np.zeros((len(directions), count + 1), np.bool_)
    start, along = np.empty((count, 3)), np.empty((count, 3))
    for n in range(len(directions)):
        d = directions[n]
        z, last = in_sphere(origin - centre, d, radius)
        into_views(origin, d, projections, start, along)
        z, last = watched(start, along, sizes, others, sides, nearest_to(origin - centre, d), 1, z, last)
        step = pixel / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        for _ in range(MOST_POINTS):  # a step that is lost in z's rounding would never end
            if not z <= last or out[n, count]:
                break
            seen, against, by, free = 0, 0, -1, np.inf
            for v in others:
                px, edge, w = beside(z, v, start, along, distance, sizes)
                seen += px > -np.inf
                if px > TOLERANCE:
                    px = min(0.9 * (px - TOLERANCE), edge)
                    against, by, free = against + 1, v, min(free, px * w / (focals[v] + px))
                    if against > 1:
                        break
            if against <= 1 and seen - against >= min(WITNESSES, len(others) - against):
                out[n, by if against else count] = True
            z += step * (max(1.0, free // pixel) if against > 1 else 1.0)
        if out[n, count]:
            out[n, :] = True
    return out
