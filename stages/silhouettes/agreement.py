"""Do the silhouettes of several views fit together? A foreground pixel is explained when somewhere along its ray no
other view sees background.

A silhouette that is wrong as a whole (shifted, another moment, another camera) carves the subject away in all other
views. It is found because the others explain each other once it is left out. All rays are walked once: a point that a
single view carves would be explained without that view.

A part of a mask that is not the subject, somebody else's arm that reaches into the picture or a piece of the floor, has
rays that the others leave nothing of, as a limb has that one of the others lacks. That one, overruled, explains the
limb; a stray part nothing explains but several views overruled at once, each elsewhere. And a limb that several views
lack is shown by all the others, a stray part by few.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.hull import OUTVOTED, Silhouettes
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
PART = 0.01
"""Share of a view's foreground that a stray part has, at least: less is an outline that runs a little beside others."""
WRONG = 0.3
"""Share of a view's foreground that the others contradict from which on its mask is wrong as a whole, and asked nothing
of."""
EXPLAINED = 0.7
"""Share of a part's rays that is left once a single other view is overruled, from which on that view may lack it. Hands
and feet that one view of six lacks: 0.79 to 1; an arm in two masks, pieces of floor in one: 0.12 to 0.64."""
SHOWN = 0.5
"""Share of a part's rays on which another view has something that nobody explains, from which on it shows it, too."""
PART_RAYS = 300
"""Rays of a part that are asked, about."""
RIM = 3
"""Px beyond a stray part that its soft edge reaches."""


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


def settled(
    rig: Rig, masks: Mapping[int, np.ndarray], centre: np.ndarray, radius: float
) -> tuple[Mapping[int, np.ndarray], Silhouettes, Agreement]:
    """(masks [h, w] uint8 by view without stray parts, what was prepared of them, what they say of each other); the
    subject is searched within `radius` m around `centre` [3]."""
    silhouettes = Silhouettes.of(rig, masks, centre, radius)
    found = agreement(rig, masks, silhouettes)
    stray = strays(rig, masks, silhouettes.kept(set(found.carving)), found.unexplained)
    if not stray:
        return masks, silhouettes, found
    masks = {v: np.where(stray[v], 0, m).astype(np.uint8) if v in stray else m for v, m in masks.items()}
    silhouettes = Silhouettes.of(rig, masks, centre, radius)
    return masks, silhouettes, agreement(rig, masks, silhouettes)


def strays(
    rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes, unexplained: Mapping[int, float]
) -> dict[int, np.ndarray]:
    """[h, w] bool by view: stray parts of masks [h, w] uint8 and their soft edges; views without any are missing.

    unexplained: share of each view's foreground that the silhouettes contradict, as `agreement` says. Of so few
    views that none can be overruled nothing is stray.
    """
    views = silhouettes.views
    asked = [v for v in views if PART <= unexplained[v] < WRONG] if len(views) > OUTVOTED else []
    lost = {v: _lost(rig, v, masks[v], silhouettes) for v in asked}
    out = {}
    for v in asked:
        others = {
            u: Silhouettes.of(rig, {u: m.astype(np.uint8) * 255}, silhouettes.centre, silhouettes.radius, TOLERANCE)
            for u, m in lost.items()
            if u != v
        }
        stray = np.zeros(masks[v].shape, np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(lost[v].astype(np.uint8), connectivity=8)
        for part in range(1, count):
            if stats[part, cv2.CC_STAT_AREA] >= PART * foreground(masks[v]).sum():
                inside = labels == part
                if _nobodys(rig, v, inside, silhouettes, others):
                    stray |= inside
        if stray.any():
            out[v] = _with_ends(stray > 0, foreground(masks[v]), lost[v], rig.size[v])
    return out


def _with_ends(stray: np.ndarray, inside: np.ndarray, lost: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[h, w] bool: stray parts of a mask's foreground [h, w], what of it lies between them and the edge of the picture
    of `size` (width, height), where few other cameras see anything, and their soft edges. `lost`: what nobody
    explains."""
    labels = cv2.connectedComponents((inside & ~stray).astype(np.uint8), connectivity=8)[1]
    touched, areas = np.unique(labels[_around(stray) & (labels > 0)]), np.bincount(labels.ravel())
    rim = np.concatenate([labels[0], labels[size[1] - 1], labels[:, 0], labels[:, size[0] - 1]])
    ends = [i for i in touched if i in rim and areas[i] < stray.sum()]
    stray = stray | np.isin(labels, ends)
    return stray | (_around(stray) & (lost | ~inside))


def _around(part: np.ndarray) -> np.ndarray:
    return cv2.dilate(part.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)) > 0


def _nobodys(rig: Rig, view: int, part: np.ndarray, silhouettes: Silhouettes, lost: Mapping[int, Silhouettes]) -> bool:
    """Whether a part [h, w] bool of a view's mask is stray; `lost`: what nobody explains of other views, by view."""
    pixels = np.flatnonzero(part)
    origin, directions = _rays(rig, view, pixels[:: max(1, len(pixels) // PART_RAYS)], part.shape[1])

    def met(by: Silhouettes) -> float:
        return float(by.met(origin, directions, TOLERANCE, without=view).mean())

    views = {*silhouettes.views}
    shown = 1 + sum(met(other) >= SHOWN for other in lost.values() if other.views)
    if 2 * shown >= len(views):
        return False
    return all(met(silhouettes.kept(views - {u})) < EXPLAINED for u in views - {view})


def _lost(rig: Rig, view: int, mask: np.ndarray, silhouettes: Silhouettes) -> np.ndarray:
    """[h, w] bool: foreground of a view's mask that the other silhouettes leave nothing of."""
    out = foreground(mask)
    out[rig.size[view, 1] :], out[:, rig.size[view, 0] :] = False, False
    pixels = np.flatnonzero(out)
    origin, directions = _rays(rig, view, pixels, out.shape[1])
    out.flat[pixels[silhouettes.met(origin, directions, TOLERANCE, without=view)]] = False
    return out


def _rays(rig: Rig, view: int, pixels: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and directions [N, 3] of rays through pixels [N] of a picture, counted row by row."""
    rows, columns = np.divmod(pixels, width)
    return rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[view], rig.world_to_camera[view]
    )
