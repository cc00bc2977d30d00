"""Where a few silhouettes contradict all others, they have no say: at that place, and there alone.

A foreground pixel of a view whose ray the other silhouettes leave nothing of is contradicted. Where a point of its ray
is carved by a few views, and seen as foreground by more of the others, those views' masks lack something there, or end
elsewhere than theirs: around the places where they see the point they carve nothing from then on. Where more views
carve than a few, or than say so, the pixel itself is what is wrong. The point that is carved by the fewest, and by them
the least, is taken: where the ray passes nearer to another outline, or elsewhere by the same one, a disc is given up
there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.agreement import settled
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
OVERRULED, ONE_OF = 2, 4
"""Silhouettes, at most, that have no say at a place: so many, or one of so many where that is more."""
AROUND = 4.0
"""Px around a place that are given up: more than half the diagonal of a stride."""
MISSING = (1.5, 0.0065)
"""Px, and share of the picture's longer side, by which a place without a say reaches beyond a mask, `AROUND` taken off,
from which on something is missing there. Along the rims of a head's seven photographs outlines err by up to 0.006."""

STRAY = 2.0
"""Px outside its silhouette from which on what a mask holds was taken out of it: soft edges reach less far."""


def reconciled(
    rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes, unexplained: Mapping[int, float]
) -> Silhouettes:
    """The silhouettes of masks [h, w] uint8 by view, each without a say where it contradicts the others.

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
    """[S, h, w] uint8: where a silhouette carves foreground rays that others agree on, see `reconciled`: 1 alone, 2
    together with others. As many views as carve must say so: fewer may be what is wrong.
    """
    out, views = np.zeros(silhouettes.distance.shape, np.uint8), silhouettes.views
    fewest, told = np.zeros_like(out), np.zeros_like(out)
    for view in views if len(views) >= OUTVOTED else ():
        if unexplained[view] >= BELIEVED:
            continue
        for most in (SAMPLE, None):
            origin, directions = foreground_rays(rig, view, masks[view], most)
            lost = directions[missed(silhouettes, view, origin, directions)]
            if not len(lost):
                break
        else:
            carvers = few_carvers(silhouettes, view, origin, lost)
            out |= carvers == 1
            if (together := carvers > 1).any():
                fewest = np.where(together & ((fewest == 0) | (carvers < fewest)), carvers, fewest)
                told += np.stack([cv2.dilate(t.astype(np.uint8), disc(AROUND)) for t in together])
    out[(out == 0) & (fewest > 0) & (told >= fewest)] = 2
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
    """What the masks [h, w] uint8 of one frame say, by view; of those that fit the others, each but where it
    contradicts them and without stray parts, and of none where no mask has a background."""
    views = sorted(masks)
    if not views:
        return Silhouettes.of(rig, {}, np.zeros(3), 0.0)
    centre = look_at_point(rig.subset(views))
    radius = searched_radius(rig, views, centre)
    if all(foreground(m[: rig.size[v, 1], : rig.size[v, 0]]).all() for v, m in masks.items()):
        return Silhouettes.of(rig, {}, centre, radius)
    masks, silhouettes, found = settled(rig, masks, centre, radius)
    return reconciled(rig, masks, silhouettes.kept(set(found.carving)), found.unexplained)


def lacking(silhouettes: Silhouettes, view: int, mask: np.ndarray) -> np.ndarray:
    """[h, w] bool: where a view's mask [h, w] uint8 has nothing though the other views' have something there, by what
    `agreed` left of them: the places without a say that reach farther than outlines err, and all that is empty of a
    mask that carves nothing at all."""
    empty = mask == 0
    if view not in silhouettes.views:
        return empty
    high, wide = mask.shape
    unheard = empty & (silhouettes.distance[silhouettes.views.index(view), :high, :wide] <= -TOLERANCE)
    if not unheard.any():
        return unheard
    far = AROUND + max(MISSING[0], MISSING[1] * max(high, wide))
    beyond = cv2.distanceTransform(empty.astype(np.uint8), cv2.DIST_L2, 5) > far
    parts = cv2.connectedComponents(unheard.astype(np.uint8))[1]
    return unheard & np.isin(parts, parts[unheard & beyond])


def beyond(silhouettes: Silhouettes, view: int, mask: np.ndarray) -> np.ndarray:
    """[h, w] bool: where a view's mask [h, w] uint8 has something that `agreed` took out of it: stray parts."""
    if view not in silhouettes.views:
        return np.zeros(mask.shape, bool)
    high, wide = mask.shape
    return (mask > 0) & (silhouettes.distance[silhouettes.views.index(view), :high, :wide] > STRAY)


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


def few_carvers(silhouettes: Silhouettes, view: int, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[S, h, w] uint8: in the pictures of the few silhouettes that carve a ray [N, 3] of `view`, where they see the
    point that they carve the least, how many these are, at least; 0 elsewhere. Rays that many carve everywhere mark
    nothing."""
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
        max(OVERRULED, len(silhouettes.views) // ONE_OF),
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
    most: int,
    out: np.ndarray,
) -> None:
    """Mark in out [S, h, w] the pixels at which the fewest of the `others`, `most` at most, carve a ray [N, 3] the
    least, by how many they are; the first `sides` of the others look from the side. `pixel` metres a step. A ray
    without such a point, which more than carve it see, marks none."""
    count = projections.shape[0]
    start, along = np.empty((count, 3)), np.empty((count, 3))
    carvers, by = np.empty(most, np.int64), np.empty(most, np.int64)
    for n in range(len(directions)):
        d = directions[n]
        z, last = in_sphere(origin - centre, d, radius)
        into_views(origin, d, projections, start, along)
        z, last = watched(start, along, sizes, others, sides, nearest_to(origin - centre, d), 1, z, last)
        step = pixel / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        fewest, least, at = most, np.inf, 0.0
        for _ in range(MOST_POINTS):  # a step that is lost in z's rounding would never end
            if not z <= last:
                break
            seen, against, far = 0, 0, 0.0
            for v in others:
                px, _edge, _w = beside(z, v, start, along, distance, sizes)
                seen += px > -np.inf
                if px > TOLERANCE:
                    against, far = against + 1, max(far, px)
                    if against > fewest:
                        break
                    carvers[against - 1] = v
            enough = 0 < against <= fewest and seen - against >= max(WITNESSES, against + 1)
            if enough and (against < fewest or far < least):
                fewest, least, at = against, far, z
                by[:against] = carvers[:against]
            z += step
        for v in by[: fewest if least < np.inf else 0]:
            w = start[v, 2] + at * along[v, 2]
            column = int((start[v, 0] + at * along[v, 0]) / w + 0.5)
            row = int((start[v, 1] + at * along[v, 1]) / w + 0.5)
            out[v, row, column] = fewest if out[v, row, column] == 0 else min(fewest, out[v, row, column])
