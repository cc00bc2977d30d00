"""How a ray is walked through silhouettes: from the boxes around them in strides that no silhouette can fill, until it
enters what all of them keep."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.silhouettes.distance import TRUE

WITNESSES = 2
"""Other views that must see a point of the hull, where there are as many."""
OF_THOSE = 3
"""Of so many views to the side that see a ray by the subject's middle one must see a point of the hull, too. Where
cameras stand in stacks, the others of one's own stack and those of the opposite one keep a ray up to the camera."""
BISECTIONS = 4
"""Halvings of the last step: a sixteenth of a pixel."""
EDGE = 1e-6
"""Px beyond the outermost pixel centres that count as on them: what a camera sees of rays through its own outermost
pixels must not hang on rounding."""
DEEPER = 4.0
"""Steps within the hull from where a ray enters it, where the next ray is likely to be within, too."""
MOST_POINTS = 2**15
"""Points of a ray that are looked at: about as many as a ray has px in the largest pictures. Cameras of another
scale than the scene would walk for ever."""


@compiled(error_model="numpy", forceinline=True)
def beside(
    z: float, v: int, start: np.ndarray, along: np.ndarray, distance: np.ndarray, sizes: np.ndarray
) -> tuple[float, float, float]:
    """Of a ray's point at depth z in view v: px outside the silhouette, px to the picture's edge and depth; (-inf, 0,
    0) where it is not seen.

    Seen is what lies in front of the camera and between the outermost pixel centres. Whole arrays are handed over: a
    slice costs more than the rest. Inlined: to hand over so many arrays at every point takes as long as the point.
    """
    w = start[v, 2] + z * along[v, 2]
    if w <= 1e-9:
        return -np.inf, 0.0, 0.0
    share = 1 / w
    x, y = (start[v, 0] + z * along[v, 0]) * share, (start[v, 1] + z * along[v, 1]) * share
    right, bottom = sizes[v, 0] - 1, sizes[v, 1] - 1
    if x < -EDGE or y < -EDGE or x > right + EDGE or y > bottom + EDGE:
        return -np.inf, 0.0, 0.0
    x, y = min(max(x, 0.0), right), min(max(y, 0.0), bottom)
    column, row, one = np.uint32(min(x, right - 0.5)), np.uint32(min(y, bottom - 0.5)), np.uint32(1)
    a, b = x - column, y - row
    top = distance[v, row, column] + a * (distance[v, row, column + one] - distance[v, row, column])
    low = distance[v, row + one, column] + a * (distance[v, row + one, column + one] - distance[v, row + one, column])
    return top + b * (low - top), min(min(x, y), min(right - x, bottom - y)), w


@compiled(error_model="numpy", forceinline=True)
def stride(px: float, ahead: float, w: float, v: int, along: np.ndarray, moves: np.ndarray) -> float:
    """By how much depth must grow (`ahead` 1) or fall (-1) until a ray's point, w in front of view v, has moved by px
    there: |z' - z| moves / (w w') with w' its distance then. inf where it never does."""
    slower = moves[v] - ahead * px * w * along[v, 2]
    return px * w * w / slower if slower > 0 else np.inf


@compiled(error_model="numpy", forceinline=True)
def _outside(
    z: float,
    ahead: float,
    start: np.ndarray,
    along: np.ndarray,
    moves: np.ndarray,
    distance: np.ndarray,
    sizes: np.ndarray,
    order: np.ndarray,
    tolerance: float,
    overruled: int,
) -> float:
    """0 where the ray's point at depth z lies in the hull (enough views see it, and no more than `overruled` of them
    carve it); else by how much depth may grow (`ahead` 1) or fall (-1) so that the points between surely do not.

    A view that carves goes to the front of the `order` [S] in which they are asked: it will carve the next point, too.
    """
    seen, against, free = 0, 0, np.inf
    for n in range(len(order)):
        v = order[n]
        px, edge, w = beside(z, v, start, along, distance, sizes)
        seen += px > -np.inf
        if px > tolerance:
            against += 1
            # What leaves the picture is no longer carved. 0.9: the distance transform errs by a few percent.
            free = min(free, stride(min(0.9 * (px - tolerance), edge), ahead, w, v, along, moves))
            order[n], order[0] = order[0], v
            if against > overruled:
                return max(free, 1e-9)
    return 0.0 if seen - against >= min(WITNESSES, len(order)) else 1e-9


@compiled(error_model="numpy", forceinline=True)
def farthest_outside(
    z: float,
    start: np.ndarray,
    along: np.ndarray,
    moves: np.ndarray,
    distance: np.ndarray,
    sizes: np.ndarray,
    scales: np.ndarray,
    order: np.ndarray,
    most: float,
) -> tuple[float, float]:
    """Px by which a ray's point at depth z lies outside the silhouette it is farthest from, `most` where that is more
    or too few see it; and how much deeper the ray surely goes on as far outside as that, if it is.

    The view that says so goes to the front of the `order` in which they are asked: it will say so of the next point.
    """
    seen, worst = 0, 0.0
    for n in range(len(order)):
        v = order[n]
        px, edge, w = beside(z, v, start, along, distance, sizes)
        seen += px > -np.inf
        worst = max(worst, px * scales[v])
        if worst >= most:
            order[n], order[0] = order[0], v
            return most, stride(min(TRUE * (px - most / scales[v]), edge), 1.0, w, v, along, moves)
    return (worst if seen >= min(WITNESSES, len(order)) else most), 0.0


@compiled(error_model="numpy", forceinline=True)
def _kept(constant: float, slope: float, z0: float, z1: float) -> tuple[float, float]:
    """The part of [z0, z1] where constant + slope z is not negative. Empty: (inf, -inf)."""
    low, high = constant + slope * z0, constant + slope * z1
    if low < 0:
        return (np.inf, -np.inf) if high < 0 else (-constant / slope, z1)
    return (z0, -constant / slope) if high < 0 else (z0, z1)


@compiled(error_model="numpy")
def _part(
    start: np.ndarray, along: np.ndarray, v: int, x0: float, y0: float, x1: float, y1: float, z0: float, z1: float
) -> tuple[float, float]:
    """The part of [z0, z1] that view v sees inside a box of its picture; a box is convex, so there is one part. Empty:
    (inf, -inf)."""
    x, y, w = start[v, 0], start[v, 1], start[v, 2]
    dx, dy, dw = along[v, 0], along[v, 1], along[v, 2]
    z0, z1 = _kept(x - x0 * w, dx - x0 * dw, z0, z1)
    if z0 <= z1:
        z0, z1 = _kept(y - y0 * w, dy - y0 * dw, z0, z1)
    if z0 <= z1:
        z0, z1 = _kept(x1 * w - x, x1 * dw - dx, z0, z1)
    if z0 <= z1:
        z0, z1 = _kept(y1 * w - y, y1 * dw - dy, z0, z1)
    if z0 <= z1:
        z0, z1 = _kept(w, dw, z0, z1)
    return z0, z1


@compiled
def _witnessed(
    seen: np.ndarray, sides: int, middle: float, overruled: int, z0: float, z1: float
) -> tuple[float, float]:
    """The part of [z0, z1] between whose ends enough views see the ray, each a part `seen` [S, 2] of it: `WITNESSES` of
    all, and of the first `sides` one of `OF_THOSE` that see it at depth `middle`, of which so many are `overruled`."""
    first = second = np.inf
    last = last_but_one = -np.inf
    for low, high in seen:
        if low < first:
            first, second = low, first
        elif low < second:
            second = low
        if high > last:
            last, last_but_one = high, last
        elif high > last_but_one:
            last_but_one = high
    z0, z1 = (max(z0, first), min(z1, last)) if len(seen) < WITNESSES else (max(z0, second), min(z1, last_but_one))
    there = -overruled
    for low, high in seen[:sides]:
        there += low <= middle <= high
    needed = -(-there // OF_THOSE)
    if needed <= 0:
        return z0, z1
    return max(z0, np.sort(seen[:sides, 0])[needed - 1]), min(z1, np.sort(seen[:sides, 1])[sides - needed])


@compiled
def watched(
    start: np.ndarray,
    along: np.ndarray,
    sizes: np.ndarray,
    among: np.ndarray,
    sides: int,
    middle: float,
    overruled: int,
    z0: float,
    z1: float,
) -> tuple[float, float]:
    """The part of [z0, z1] that enough of the views `among` all, but those `overruled`, see to be of the hull, whatever
    they carve."""
    seen = np.empty((len(among), 2))
    for n in range(len(among)):
        v = among[n]
        seen[n, 0], seen[n, 1] = _part(start, along, v, 0.0, 0.0, sizes[v, 0] - 1, sizes[v, 1] - 1, z0, z1)
    return _witnessed(seen, sides, middle, overruled, z0, z1)


@compiled
def clip_ray(
    start: np.ndarray,
    along: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    among: np.ndarray,
    sides: int,
    middle: float,
    z0: float,
    z1: float,
) -> tuple[float, float]:
    """The part of [z0, z1] that can hold the hull of the views `among` all, the first `sides` of which look at the ray
    from the side: seen by enough of them, also of those that see it at depth `middle`, where it passes the subject's
    middle, and in the box of all that see its ends."""
    views = len(among)
    seen, kept = np.empty((views, 2)), np.empty((views, 2))
    for n in range(views):
        v = among[n]
        seen[n, 0], seen[n, 1] = _part(start, along, v, 0.0, 0.0, sizes[v, 0] - 1, sizes[v, 1] - 1, z0, z1)
        kept[n, 0], kept[n, 1] = _part(start, along, v, boxes[v, 0], boxes[v, 1], boxes[v, 2], boxes[v, 3], z0, z1)
    z0, z1 = _witnessed(seen, sides, middle, 0, z0, z1)
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


@compiled
def _end(
    z: float,
    step: float,
    last: float,
    start: np.ndarray,
    along: np.ndarray,
    moves: np.ndarray,
    distance: np.ndarray,
    sizes: np.ndarray,
    order: np.ndarray,
    how: tuple[float, int],
) -> float:
    """Depth at which the walk from z by `step` towards `last` enters the hull, refined by bisection; -1 if it never
    does."""
    count = int(min(abs(last - z) / abs(step), MOST_POINTS)) + 2
    ahead = 1.0 if step > 0 else -1.0
    i = 0
    while i < count:
        here = z + i * step if i < count - 1 else last
        free = _outside(here, ahead, start, along, moves, distance, sizes, order, how[0], how[1])
        if free == 0:
            if i == 0:
                return here
            outside, inside = z + (i - 1) * step, here
            for _ in range(BISECTIONS):
                middle = 0.5 * (outside + inside)
                if _outside(middle, ahead, start, along, moves, distance, sizes, order, how[0], how[1]) == 0:
                    inside = middle
                else:
                    outside = middle
            return inside
        i += max(1, int(min(free / abs(step), count)))
    return -1.0


@compiled
def march(
    origin: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    tries: list[tuple[float, int]],
    among: np.ndarray,
    sides: int,
    ends: np.ndarray,
) -> None:
    """Fill ends [N, 2] with near and far depth of each ray [N, 3], 0 where the ray has no hull.

    `pixel` is metres a step; `tries` are (tolerance px, views overruled), one after the other until there is a hull;
    `among` are the views that it is the hull of, the first `sides` of them those to the side of the rays.
    """
    views = projections.shape[0]
    start, along, order = np.empty((views, 3)), np.empty((views, 3)), among.copy()
    moves = np.empty(views)
    for n in range(directions.shape[0]):
        ends[n, 0] = ends[n, 1] = 0.0
        d = directions[n]
        first, last = in_sphere(origin - centre, d, radius)
        if last <= first:
            continue
        into_views(origin, d, projections, start, along)
        motion(start, along, moves)
        step = pixel / math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        middle = nearest_to(origin - centre, d)
        clipped = clip_ray(start, along, boxes, sizes, among, sides, middle, first, last)
        for how in tries:
            # A view that is overruled does not clip either, but to where enough others look.
            z0, z1 = watched(start, along, sizes, among, sides, middle, how[1], first, last) if how[1] else clipped
            if z1 <= z0:
                continue
            near = _end(z0, step, z1, start, along, moves, distance, sizes, order, how)
            if near >= 0:
                ends[n, 0] = near
                # The way back may stride over a hull thinner than a step: then it is as thick as the point found.
                ends[n, 1] = max(near, _end(z1, -step, near, start, along, moves, distance, sizes, order, how))
                break


@compiled
def meets(
    origin: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    tolerance: float,
    among: np.ndarray,
    sides: int,
    found: np.ndarray,
) -> None:
    """Fill found [N] bool: whether a ray [N, 3] has a point in the hull of the views `among` all; otherwise as `march`.

    Of rays in the order of their pixels most meet the hull at the depth where the one before did, which is looked at
    first.
    """
    views = projections.shape[0]
    start, along, order = np.empty((views, 3)), np.empty((views, 3)), among.copy()
    moves, how, at = np.empty(views), (tolerance, 0), -1.0
    for n in range(directions.shape[0]):
        d = directions[n]
        found[n] = False
        z0, z1 = in_sphere(origin - centre, d, radius)
        if z1 <= z0:
            continue
        into_views(origin, d, projections, start, along)
        motion(start, along, moves)
        if z0 <= at <= z1 and _outside(at, 1.0, start, along, moves, distance, sizes, order, tolerance, 0) == 0:
            found[n] = True
            continue
        z0, z1 = clip_ray(start, along, boxes, sizes, among, sides, nearest_to(origin - centre, d), z0, z1)
        if z1 <= z0:
            continue
        step = pixel / math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        near = _end(z0, step, z1, start, along, moves, distance, sizes, order, how)
        if near >= 0:
            found[n], at = True, near + DEEPER * step


@compiled
def into_views(
    origin: np.ndarray, d: np.ndarray, projections: np.ndarray, start: np.ndarray, along: np.ndarray
) -> None:
    """Fill start and along [S, 3]: the point at depth z of a ray is start + z along in the views' homogeneous px."""
    for v in range(projections.shape[0]):
        for i in range(3):
            p = projections[v, i]
            start[v, i] = p[0] * origin[0] + p[1] * origin[1] + p[2] * origin[2] + p[3]
            along[v, i] = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]


@compiled
def motion(start: np.ndarray, along: np.ndarray, moves: np.ndarray) -> None:
    """Fill moves [S]: between depths z and z', w and w' in front of a view, a ray's point moves by moves |z' - z| / (w
    w') px there."""
    for v in range(len(moves)):
        across = along[v, 0] * start[v, 2] - start[v, 0] * along[v, 2]
        down = along[v, 1] * start[v, 2] - start[v, 1] * along[v, 2]
        moves[v] = math.sqrt(across * across + down * down)


@compiled
def in_sphere(to: np.ndarray, d: np.ndarray, radius: float) -> tuple[float, float]:
    """Depths at which a ray along d [3] enters and leaves a sphere, `to` [3] from the sphere's middle to the ray's
    origin; (1, 0) where it misses it."""
    a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    b = d[0] * to[0] + d[1] * to[1] + d[2] * to[2]
    inside = b * b - a * (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - radius * radius)
    if inside <= 0:
        return 1.0, 0.0
    return max((-b - math.sqrt(inside)) / a, 1e-3), (-b + math.sqrt(inside)) / a


@compiled
def nearest_to(to: np.ndarray, d: np.ndarray) -> float:
    """Depth at which a ray along d [3] is nearest to a point, `to` [3] from there to the ray's origin."""
    return -(d[0] * to[0] + d[1] * to[1] + d[2] * to[2]) / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
