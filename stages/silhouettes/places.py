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
from numba import njit

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.hull import (
    MOST_POINTS,
    OUTVOTED,
    WITNESSES,
    Silhouettes,
    beside,
    foreground,
    in_sphere,
    into_views,
)
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

STRIDE = 5
"""Px from one foreground pixel that is asked to the next; every pixel of a rim is."""
TOLERANCE = 0.5
"""Px by which a silhouette may be wider than drawn: exact masks then explain every pixel."""
AROUND = 4.0
"""Px around a place that are given up: more than half the diagonal of a stride."""


def reconciled(rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes) -> Silhouettes:
    """The silhouettes of masks [h, w] uint8 by view, each without a say where it alone contradicts the others.

    Of fewer than four views nobody can be overruled: they stay as they are.
    """
    views = silhouettes.views
    if len(views) < OUTVOTED:
        return silhouettes
    given_up = np.zeros(silhouettes.distance.shape, np.uint8)
    for own, view in enumerate(views):
        pixels = points_from_integer_centres(_asked(foreground(masks[view][: rig.size[view, 1], : rig.size[view, 0]])))
        origin, directions = rays(pixels, rig.intrinsics[view], rig.world_to_camera[view])
        left = silhouettes.kept({*views} - {view}).ends(origin, directions, (TOLERANCE, TOLERANCE), votes=False)
        _give_up(
            origin,
            directions[left[:, 0] == 0],
            own,
            silhouettes.distance,
            silhouettes.projections,
            silhouettes.sizes,
            silhouettes.centre,
            silhouettes.radius,
            silhouettes.pixel,
            given_up,
        )
    if not given_up.any():
        return silhouettes
    size = 2 * int(np.ceil(AROUND)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    around = np.stack([cv2.dilate(g, disc) for g in given_up]) > 0
    # A box around the foreground clips rays before any pixel is asked: it must not say what the pixels do not.
    boxes = silhouettes.boxes.copy()
    for i, place in enumerate(around):
        if place.any():
            rows, columns = np.nonzero(place)
            boxes[i, :2] = np.maximum(np.minimum(boxes[i, :2], [columns.min() - 1, rows.min() - 1]), 0)
            boxes[i, 2:] = np.minimum(
                np.maximum(boxes[i, 2:], [columns.max() + 1, rows.max() + 1]), silhouettes.sizes[i] - 1
            )
    distance = np.where(around, np.minimum(silhouettes.distance, -TOLERANCE), silhouettes.distance)
    return replace(silhouettes, distance=distance.astype(np.float32), boxes=boxes)


def _asked(inside: np.ndarray) -> np.ndarray:
    """[n, 2] columns and rows of the foreground [h, w] that are asked: a grid, and the rim."""
    chosen = inside & (cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    chosen[::STRIDE, ::STRIDE] |= inside[::STRIDE, ::STRIDE]
    rows, columns = np.nonzero(chosen)
    return np.stack([columns, rows], axis=-1)


@njit(cache=True, nogil=True)
def _give_up(
    origin: np.ndarray,
    directions: np.ndarray,
    own: int,
    distance: np.ndarray,
    projections: np.ndarray,
    sizes: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    out: np.ndarray,
) -> None:
    """Mark in out [S, h, w] the pixel at which a single view carves a ray [N, 3] of view `own` the least; `pixel`
    metres a step. A ray without such a point marks nothing."""
    count = projections.shape[0]
    start, along = np.empty((count, 3)), np.empty((count, 3))
    for n in range(len(directions)):
        d = directions[n]
        z, last = in_sphere(origin - centre, d, radius)
        into_views(origin, d, projections, start, along)
        step = pixel / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        least, by, at = np.inf, -1, 0.0
        for _ in range(MOST_POINTS):  # a step that is lost in z's rounding would never end
            if not z <= last:
                break
            seen, against, carver, far = 0, 0, -1, 0.0
            for v in range(count):
                if v == own:
                    continue
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
