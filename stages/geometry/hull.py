"""The visual hull seen from one view: the nearest and the farthest point of every pixel's ray that all masks allow.

Image-based: no voxels. For each foreground pixel the ray is first clipped, exactly, to the boxes around the other views'
masks, then walked in steps of about one pixel of motion in the other views; both ends are refined by bisection
(Matusik et al., "Image-based visual hulls", 2000, find the same intervals on the epipolar lines).

A view carves only what it can see: a point beside its picture or behind its camera stays, and a view whose mask is empty
says nothing. A point that fewer than two other views see (or the only other one) is not part of the hull, because too
little speaks for it: the opposite camera of a ring sees a ray from end to end and carves none of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numba import njit

from stages.geometry.projection import rays
from storage.rig import Rig, points_from_integer_centres, to_integer_centres

FOREGROUND = 127
"""A mask value above this is foreground."""
REACH = 0.9
"""Radius of the searched sphere over the distance of the nearest camera: the sphere holds no camera."""
WITNESSES = 2
"""Other views that must see a point of the hull, where there are as many."""
TOLERANCE = (0.0, 1.5)
"""Px a point may lie outside another view's silhouette; the second value only for rays without a hull at the first."""
BISECTIONS = 6
"""Halvings of the last step: a sixty-fourth of a pixel."""


def foreground(mask: np.ndarray) -> np.ndarray:
    """[...] uint8 mask, 0..255 -> bool."""
    return mask > FOREGROUND


def searched_radius(rig: Rig, views: list[int], centre: np.ndarray) -> float:
    """Metres: radius of the sphere around `centre` [3] in which the subject of these views is searched."""
    return REACH * float(np.linalg.norm(rig.centres[views] - centre, axis=1).min())


def visual_hull(rig: Rig, view: int, masks: Mapping[int, np.ndarray], centre: np.ndarray, radius: float, tolerance: tuple[float, float] = TOLERANCE) -> tuple[np.ndarray, np.ndarray]:
    """Near and far depth [h, w] float32 of the hull along each foreground ray of `view`, metres along its optical axis.

    `masks` [h, w] uint8 by view index, `view` among them; the pictures lie at the top left of the arrays and `rig.size`
    says how large they are. `centre` [3] and `radius`, world metres, bound the search. `tolerance` in px lets a point lie
    that far outside another view's silhouette; rays that miss the hull are tried again with the second value, so that
    errors of calibration and matting do not eat limbs. Both maps are 0 where the pixel is background and where no point
    of its ray is inside all masks.
    """
    own = foreground(masks[view])
    near, far = np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
    others = [v for v in sorted(masks) if v != view and foreground(masks[v][: rig.size[v, 1], : rig.size[v, 0]]).any()]
    rows, columns = np.nonzero(own)
    if not others or not rows.size:
        return near, far
    origin, directions = rays(points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[view], rig.world_to_camera[view])
    stack = np.stack([_distance_to_foreground(masks[v], rig.size[v]) for v in others])
    projections = to_integer_centres(rig.intrinsics[others]) @ rig.world_to_camera[others, :3]
    boxes = np.stack([_box(masks[v], rig.size[v], max(tolerance)) for v in others])
    sizes = np.ascontiguousarray(rig.size[others], dtype=np.float64)
    pixel = float((np.linalg.norm(rig.centres[others] - centre, axis=1) / rig.intrinsics[others, 0, 0]).min())
    ends = np.empty((len(rows), 2))
    _march(origin, directions, stack, projections, boxes, sizes, centre, radius, pixel, tolerance, ends)
    near[rows, columns], far[rows, columns] = ends.T
    return near, far


def _distance_to_foreground(mask: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[h, w] float32: px by which a pixel lies outside the silhouette, sub-pixel from the soft edge, saturated at 8; inside <= 0."""
    import cv2

    soft = mask[: size[1], : size[0]]
    inside = foreground(soft)
    steps = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 3)
    out = np.full(mask.shape, 8.0, np.float32)
    # Around the edge the covered share itself says where the silhouette runs: share 1/2 at distance 0.
    edge = 0.5 - soft.astype(np.float32) / 255
    out[: size[1], : size[0]] = np.minimum(np.where(inside, np.minimum(edge, 0), np.where(soft > 0, np.minimum(edge, steps), np.maximum(steps - 0.5, 0.5))), 8)
    return out


def _box(mask: np.ndarray, size: np.ndarray, tolerance: float) -> np.ndarray:
    """[4] x0, y0, x1, y1 in integer-centre px: the part of a picture outside which it carves everything it sees."""
    inside = foreground(mask[: size[1], : size[0]])
    rows, columns = np.nonzero(inside.any(axis=1))[0], np.nonzero(inside.any(axis=0))[0]
    margin = tolerance + 1.0
    low = np.maximum(np.array([columns[0], rows[0]]) - margin, 0)
    high = np.minimum(np.array([columns[-1], rows[-1]]) + margin, size - 1)
    return np.concatenate([low, high]).astype(np.float64)


@njit(cache=True, nogil=True)
def _sees(x: float, y: float, w: float, size: np.ndarray) -> bool:
    """Whether a projected point (homogeneous, integer centres) lies in front of the camera and between the outermost pixel centres."""
    return w > 1e-9 and x >= 0 and y >= 0 and x <= (size[0] - 1) * w and y <= (size[1] - 1) * w


@njit(cache=True, nogil=True)
def _allowed(z: float, start: np.ndarray, along: np.ndarray, distance: np.ndarray, sizes: np.ndarray, tolerance: float) -> bool:
    """Whether the ray's point at depth z lies in the hull: no view that sees it carves it, and enough see it."""
    seen = 0
    for v in range(start.shape[0]):
        w = start[v, 2] + z * along[v, 2]
        x = start[v, 0] + z * along[v, 0]
        y = start[v, 1] + z * along[v, 1]
        if not _sees(x, y, w, sizes[v]):
            continue
        seen += 1
        x /= w
        y /= w
        column = min(int(x), int(sizes[v, 0]) - 2)
        row = min(int(y), int(sizes[v, 1]) - 2)
        a, b = x - column, y - row
        top = (1 - a) * distance[v, row, column] + a * distance[v, row, column + 1]
        bottom = (1 - a) * distance[v, row + 1, column] + a * distance[v, row + 1, column + 1]
        if (1 - b) * top + b * bottom > tolerance:
            return False
    return seen >= min(WITNESSES, start.shape[0])


@njit(cache=True, nogil=True)
def _part(start: np.ndarray, along: np.ndarray, x0: float, y0: float, x1: float, y1: float, z0: float, z1: float) -> tuple[float, float]:
    """The part of [z0, z1] that one view sees inside a box of its picture; a box is convex, so there is one part. Empty: (inf, -inf)."""
    for side in range(5):
        # Side 4 is the camera's plane; the others say sign * (coordinate - bound * w) >= 0. All are linear in z.
        bound = (x0, y0, x1, y1, 0.0)[side]
        sign = -1.0 if side in (2, 3) else 1.0
        axis = 2 if side == 4 else side % 2
        slope = sign * (along[axis] - bound * along[2])
        constant = sign * (start[axis] - bound * start[2])
        low, high = constant + slope * z0, constant + slope * z1
        if low < 0 and high < 0:
            return np.inf, -np.inf
        if low < 0:
            z0 = -constant / slope
        elif high < 0:
            z1 = -constant / slope
    return z0, z1


@njit(cache=True, nogil=True)
def _clip(start: np.ndarray, along: np.ndarray, boxes: np.ndarray, sizes: np.ndarray, z0: float, z1: float) -> tuple[float, float]:
    """The part of [z0, z1] that can hold the hull: seen by enough views, and in the box of all that see its ends."""
    views = start.shape[0]
    seen, kept = np.empty((views, 2)), np.empty((views, 2))
    for v in range(views):
        seen[v, 0], seen[v, 1] = _part(start[v], along[v], 0.0, 0.0, sizes[v, 0] - 1, sizes[v, 1] - 1, z0, z1)
        kept[v, 0], kept[v, 1] = _part(start[v], along[v], boxes[v, 0], boxes[v, 1], boxes[v, 2], boxes[v, 3], z0, z1)
    witnesses = min(WITNESSES, views)
    z0, z1 = max(z0, np.sort(seen[:, 0])[witnesses - 1]), min(z1, np.sort(seen[:, 1])[views - witnesses])
    moved = True
    while moved and z0 < z1:
        moved = False
        for v in range(views):
            if kept[v, 0] > kept[v, 1]:
                # Nothing of the ray is in this box: what the view sees of it is carved.
                low, high = seen[v, 1] + 1e-9, seen[v, 0] - 1e-9
            else:
                low, high = kept[v, 0], kept[v, 1]
            if seen[v, 0] <= z0 <= seen[v, 1] and z0 < low:
                z0, moved = low, True
            if seen[v, 0] <= z1 <= seen[v, 1] and z1 > high:
                z1, moved = high, True
    return z0, z1


@njit(cache=True, nogil=True)
def _end(z: float, step: float, last: float, start: np.ndarray, along: np.ndarray, distance: np.ndarray, sizes: np.ndarray, tolerance: float) -> float:
    """Depth at which the walk from z by `step` towards `last` enters the hull, refined by bisection; -1 if it never does."""
    count = int(abs(last - z) / abs(step)) + 2
    for i in range(count):
        here = z + i * step if i < count - 1 else last
        if _allowed(here, start, along, distance, sizes, tolerance):
            if i == 0:
                return here
            outside, inside = here - step if i < count - 1 else z + (i - 1) * step, here
            for _ in range(BISECTIONS):
                middle = 0.5 * (outside + inside)
                if _allowed(middle, start, along, distance, sizes, tolerance):
                    inside = middle
                else:
                    outside = middle
            return inside
    return -1.0


@njit(cache=True, nogil=True)
def _march(
    origin: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    tolerances: tuple[float, float],
    ends: np.ndarray,
) -> None:
    """Fill ends [N, 2] with near and far depth of each ray [N, 3], 0 where the ray has no hull; `pixel` is metres a step."""
    views = projections.shape[0]
    start, along = np.empty((views, 3)), np.empty((views, 3))
    to = origin - centre
    for n in range(directions.shape[0]):
        ends[n, 0] = ends[n, 1] = 0.0
        d = directions[n]
        a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        b = d[0] * to[0] + d[1] * to[1] + d[2] * to[2]
        inside = b * b - a * (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - radius * radius)
        if inside <= 0:
            continue
        z0, z1 = max((-b - math.sqrt(inside)) / a, 1e-3), (-b + math.sqrt(inside)) / a
        for v in range(views):
            for i in range(3):
                p = projections[v, i]
                start[v, i] = p[0] * origin[0] + p[1] * origin[1] + p[2] * origin[2] + p[3]
                along[v, i] = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]
        z0, z1 = _clip(start, along, boxes, sizes, z0, z1)
        if z1 <= z0:
            continue
        step = pixel / math.sqrt(a)
        for tolerance in tolerances:
            near = _end(z0, step, z1, start, along, distance, sizes, tolerance)
            if near >= 0:
                ends[n, 0] = near
                ends[n, 1] = _end(z1, -step, near, start, along, distance, sizes, tolerance)
                break
