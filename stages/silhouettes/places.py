"""Where one silhouette contradicts all others, it has no say: at that place, and there alone.

A foreground pixel of a view whose ray the other silhouettes leave nothing of is contradicted. Where a point of its ray
is carved by a single view, and seen as foreground by enough of the others, that view's mask lacks something there, or
ends elsewhere than theirs: around the place where it sees the point it carves nothing from then on. Where several views
carve, the pixel itself is what is wrong. The point that is carved least is taken: where the ray passes nearer to
another outline, or elsewhere by the same one, a disc is given up there. What is left of a hull is then no less than
what all views but one agree on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.agreement import agreement
from posegaussian.stages.silhouettes.hull import OUTVOTED, Silhouettes, searched_radius
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

STRIDE = 5
"""Px from one foreground pixel that is asked to the next; every pixel of a rim is."""
TOLERANCE = 0.5
"""Px by which a silhouette may be wider than drawn: exact masks then explain every pixel."""
SAMPLE = 400
"""Rays of a view that are asked first; of most views all are explained."""
BELIEVED = 0.3
"""Share of a view's foreground that the others may contradict before its own mask is what is wrong."""
AROUND = 4.0
"""Px around a place that are given up: more than half the diagonal of a stride."""


def reconciled(
    rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes, unexplained: Mapping[int, float]
) -> Silhouettes:
    """The silhouettes of masks [h, w] uint8 by view, each without a say where it alone contradicts the others.

    unexplained: share of each view's foreground that the others contradict
    (`posegaussian.stages.silhouettes.agreement`): of a mask of which most is, nothing is asked. Of fewer than four
    views nobody can be overruled: they stay as they are.
    """
    places = contradicting(rig, masks, silhouettes, unexplained)
    if not places.any():
        return silhouettes
    return without_say(silhouettes, np.stack([cv2.dilate(p, disc(AROUND)) for p in places]) > 0)


def contradicting(
    rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes, unexplained: Mapping[int, float]
) -> np.ndarray:
    """[S, h, w] uint8: 1 where a silhouette alone carves foreground rays of the others, see `reconciled`."""
    out, views = np.zeros(silhouettes.distance.shape, np.uint8), silhouettes.views
    for view in views if len(views) >= OUTVOTED else ():
        if unexplained[view] >= BELIEVED:
            continue
        for most in (SAMPLE, None):
            origin, directions = foreground_rays(rig, view, masks[view], most)
            lost = directions[missed(silhouettes, view, origin, directions)]
            if not len(lost):
                break
        else:
            out |= single_carvers(silhouettes, view, origin, lost)
    return out


def without_say(silhouettes: Silhouettes, places: np.ndarray) -> Silhouettes:
    """The silhouettes, none of which carves anything in its `places` [S, h, w] bool."""
    if not places.any():
        return silhouettes
    # A box around the foreground clips rays before any pixel is asked: it must not say what the pixels do not.
    boxes = silhouettes.boxes.copy()
    for i, place in enumerate(places):
        if place.any():
            rows, columns = np.nonzero(place)
            boxes[i, :2] = np.maximum(np.minimum(boxes[i, :2], [columns.min() - 1, rows.min() - 1]), 0)
            boxes[i, 2:] = np.minimum(
                np.maximum(boxes[i, 2:], [columns.max() + 1, rows.max() + 1]), silhouettes.sizes[i] - 1
            )
    distance = np.where(places, np.minimum(silhouettes.distance, -TOLERANCE), silhouettes.distance)
    return replace(silhouettes, distance=distance.astype(np.float32), boxes=boxes)


def agreed(rig: Rig, masks: Mapping[int, np.ndarray]) -> Silhouettes:
    """What the masks [h, w] uint8 of one frame say, by view; of those that fit the others, each but where it alone
    contradicts them, and of none where no mask has a background."""
    views = sorted(masks)
    if not views:
        return Silhouettes.of(rig, {}, np.zeros(3), 0.0)
    centre = look_at_point(rig.subset(views))
    radius = searched_radius(rig, views, centre)
    if all(foreground(m[: rig.size[v, 1], : rig.size[v, 0]]).all() for v, m in masks.items()):
        return Silhouettes.of(rig, {}, centre, radius)
    silhouettes = Silhouettes.of(rig, masks, centre, radius)
    found = agreement(rig, masks, silhouettes)
    return reconciled(rig, masks, silhouettes.kept(set(found.carving)), found.unexplained)


def foreground_rays(rig: Rig, view: int, mask: np.ndarray, most: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and directions [N, 3] of rays through a mask's foreground: a grid of it and its rim, or about so many
    of those at most."""
    pixels = _asked(foreground(mask[: rig.size[view, 1], : rig.size[view, 0]]))
    some = pixels if most is None else pixels[:: max(1, len(pixels) // most)]
    return rays(points_from_integer_centres(some), rig.intrinsics[view], rig.world_to_camera[view])


def missed(silhouettes: Silhouettes, view: int, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[N] bool: rays of a view of which the other silhouettes leave nothing."""
    return ~silhouettes.met(origin, directions, TOLERANCE, without=view)


def disc(radius: float) -> np.ndarray:
    """A disc of so many px, rounded up, to dilate by."""
    size = 2 * int(np.ceil(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))


def _asked(inside: np.ndarray) -> np.ndarray:
    """[n, 2] columns and rows of the foreground [h, w] that are asked: a grid, and the rim."""
    chosen = inside & (cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    chosen[::STRIDE, ::STRIDE] |= inside[::STRIDE, ::STRIDE]
    rows, columns = np.divmod(np.flatnonzero(chosen), inside.shape[1])
    return np.stack([columns, rows], axis=-1)


def single_carvers(silhouettes: Silhouettes, view: int, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[S, h, w] uint8: 1 in the picture of the one silhouette that carves a ray [N, 3] of `view`, where it sees the
    point that it carves the least; nothing of a ray that nobody carves alone."""
    out = np.zeros(silhouettes.distance.shape, np.uint8)
    _give_up(
        origin,
        directions,
        *silhouettes.asked(origin, view),
        silhouettes.distance,
        silhouettes.projections,
        silhouettes.sizes,
        silhouettes.centre,
        silhouettes.radius,
        silhouettes.pixel,
        out,
    )
    return out


@compiled
def _give_up(
    origin: np.ndarray,
    directions: np.ndarray,
    others: np.ndarray,
    sides: int,
    distance: np.ndarray,
    projections: np.ndarray,
    sizes: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    out: np.ndarray,
) -> None:
    """Mark in out [S, h, w] the pixel at which a single one of the `others`, the first `sides` of which look from the
    side, carves a ray [N, 3] the least; `pixel` metres a step. A ray without such a point marks nothing."""
    count = projections.shape[0]
    start, along = np.empty((count, 3)), np.empty((count, 3))
    for n in range(len(directions)):
        d = directions[n]
        z, last = in_sphere(origin - centre, d, radius)
        into_views(origin, d, projections, start, along)
        z, last = watched(start, along, sizes, others, sides, nearest_to(origin - centre, d), 1, z, last)
        step = pixel / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        least, by, at = np.inf, -1, 0.0
        for _ in range(MOST_POINTS):  # a step that is lost in z's rounding would never end
            if not z <= last:
                break
            seen, against, carver, far = 0, 0, -1, 0.0
            for v in others:
                px, _edge, _w = beside(z, v, start, along, distance, sizes)
                seen += px > -np.inf
                if px > TOLERANCE:
                    against, carver, far = against + 1, v, px
                    if against > 1:
                        break
            if against == 1 and seen - 1 >= WITNESSES and far < least:
                least, by, at = far, carver, z
            z += step
        if by >= 0:
            w = start[by, 2] + at * along[by, 2]
            column = int((start[by, 0] + at * along[by, 0]) / w + 0.5)
            row = int((start[by, 1] + at * along[by, 1]) / w + 0.5)
            out[by, row, column] = 1
