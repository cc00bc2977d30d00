"""How much of a ray's pixel the hull covers, and which rays it covers as a whole.

Most pixels of a subject are covered as a whole, and that is told for many at once: where a ray runs so deep inside all
masks that no ray around it can leave them, a point is known that covers every one of them. What is left, the rim, is
walked ray by ray.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.march import (
    MOST_POINTS,
    WITNESSES,
    beside,
    clip_ray,
    in_sphere,
    into_views,
    motion,
    nearest_to,
    stride,
)

FINE = 0.5
"""Px between points of a ray near a silhouette."""
STENCIL = 2.2
"""Px from the pixel that is nearest to a point to the farthest of the four that are looked up a rounding away, and a
little: 3/2 of a pixel's diagonal."""
TRIES = 64
"""Points that are looked at, at most, for one that covers all rays around."""


def covered_around(
    silhouettes: Silhouettes, origin: np.ndarray, directions: np.ndarray, around: float
) -> tuple[np.ndarray, np.ndarray]:
    """[N] bool: whether the hull covers all rays as a whole that lie, at a depth of 1, within `around` metres of each
    direction [N, 3]; and [N] the depth at which it does so, or comes nearest to it, -1 where it is nowhere.

    What it says of a ray is what `coverage` says.
    """
    s, (among, sides) = silhouettes, silhouettes.asked(origin)
    return _covered_around(
        origin,
        directions,
        around,
        s.whole,
        s.projections,
        s.boxes,
        s.sizes,
        s.focals,
        s.centre,
        s.radius,
        FINE * s.pixel,
        among,
        sides,
    )


def coverage(
    silhouettes: Silhouettes,
    origin: np.ndarray,
    directions: np.ndarray,
    guess: np.ndarray,
    near: np.ndarray,
    enough: np.ndarray,
) -> np.ndarray:
    """[N] float32 share 0..1 of the pixels of rays [N, 3] that the hull covers.

    The largest share, along the ray, of what every mask that sees the point leaves of it: the masks' soft edges carry
    over. A point that too few see is none of the hull's, as in `posegaussian.stages.silhouettes.hull`. At depths
    `guess` [N] the ray may be covered as a whole, and where it is, a walk finds it so; at `near` [N] it may be covered
    most, which may be more than the points of a walk say. Neither is anywhere where it is not positive. A share that
    reaches what is `enough` [N] may be larger.
    """
    s, (among, sides) = silhouettes, silhouettes.asked(origin)
    return _coverage(
        origin,
        directions,
        guess,
        near,
        enough,
        s.distance,
        s.whole,
        s.projections,
        s.boxes,
        s.sizes,
        s.focals,
        s.centre,
        s.radius,
        FINE * s.pixel,
        among,
        sides,
    )


@compiled(error_model="numpy")
def _inner(
    z: float,
    off: float,
    start: np.ndarray,
    along: np.ndarray,
    whole: np.ndarray,
    sizes: np.ndarray,
    focals: np.ndarray,
    order: np.ndarray,
) -> tuple[float, float]:
    """Whether every point within `off` metres of a ray's point at depth z is seen by enough views, and lies in the
    whole part of the masks of all that see one of them: px by which it does, in the view where it is least, not
    negative if so; and metres to where it might.

    A view that says no goes to the front of the `order` [S] in which they are asked.
    """
    seen, least, free = 0, np.inf, 0.0
    for n in range(len(order)):
        v = order[n]
        w = start[v, 2] + z * along[v, 2]
        if w <= -off:
            continue
        if w <= 1.5 * off:
            return -np.inf, 0.0
        px = off * focals[v] / (w - off)
        x, y = (start[v, 0] + z * along[v, 0]) / w, (start[v, 1] + z * along[v, 1]) / w
        right, bottom = sizes[v, 0] - 1, sizes[v, 1] - 1
        if x < -px or y < -px or x > right + px or y > bottom + px:
            continue
        edge = min(min(x, y), min(right - x, bottom - y))
        if edge < px:
            return -np.inf, 0.0
        seen += 1
        inside = whole[v, int(y + 0.5), int(x + 0.5)]
        margin = inside - STENCIL - px
        if margin < least:
            least = margin
            free = -margin * w / (focals[v] - margin)
            if inside <= 0:
                order[n], order[0] = order[0], v
                return -np.inf, free
    return (least, free) if seen >= min(WITNESSES, len(order)) else (-np.inf, 0.0)


@compiled(error_model="numpy")
def _covered_around(
    origin: np.ndarray,
    directions: np.ndarray,
    around: float,
    whole: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    focals: np.ndarray,
    centre: np.ndarray,
    radius: float,
    step: float,
    among: np.ndarray,
    sides: int,
) -> tuple[np.ndarray, np.ndarray]:
    """As `covered_around`; `step` metres, all views `among` which the first `sides` look from the side."""
    count = projections.shape[0]
    found, at = np.zeros(len(directions), np.bool_), np.full(len(directions), -1.0)
    start, along = np.empty((count, 3)), np.empty((count, 3))
    order = np.arange(count)
    for n in range(len(directions)):
        d = directions[n]
        into_views(origin, d, projections, start, along)
        first, last = in_sphere(origin - centre, d, radius)
        first, last = in_sphere(origin - centre, d, max(radius - last * around - step, 0.0))
        if first >= last:
            continue
        z, last = clip_ray(start, along, boxes, sizes, among, sides, nearest_to(origin - centre, d), first, last)
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        best = -np.inf
        for _ in range(TRIES):
            if not z <= last:
                break
            off = z * around + step
            inside, free = _inner(z, off, start, along, whole, sizes, focals, order)
            if inside > best:
                best, at[n] = inside, z
            if inside >= 0:
                found[n] = True
                break
            z += max(free, off) / length
    return found, at


@compiled(error_model="numpy")
def _share(z: float, start: np.ndarray, along: np.ndarray, distance: np.ndarray, sizes: np.ndarray) -> float:
    """0..1: the least of what the masks that see a ray's point at depth z leave of it; 0 where too few do."""
    seen, share, count = 0, 1.0, start.shape[0]
    for v in range(count):
        px, _, _ = beside(z, v, start, along, distance, sizes)
        if px > -np.inf:
            seen += 1
            share = min(share, 0.5 - px)
            if share <= 0:
                return 0.0
    return share if seen >= min(WITNESSES, count) else 0.0


@compiled
def _coverage(
    origin: np.ndarray,
    directions: np.ndarray,
    guess: np.ndarray,
    near: np.ndarray,
    enough: np.ndarray,
    distance: np.ndarray,
    whole: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    focals: np.ndarray,
    centre: np.ndarray,
    radius: float,
    step: float,
    among: np.ndarray,
    sides: int,
) -> np.ndarray:
    """As `coverage`; `step` metres, all views `among` which the first `sides` look from the side."""
    count = projections.shape[0]
    out = np.zeros(len(directions), np.float32)
    start, along, moves = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    order = np.arange(count)
    for n in range(len(directions)):
        d = directions[n]
        into_views(origin, d, projections, start, along)
        if near[n] > 0:
            out[n] = _share(near[n], start, along, distance, sizes)
            if out[n] >= enough[n]:
                continue
        if guess[n] > 0 and _inner(guess[n], step, start, along, whole, sizes, focals, order)[0] >= 0:
            out[n] = 1.0
            continue
        for v in range(count):
            order[v] = v  # a ray's points must not depend on the rays before it
        first, last = in_sphere(origin - centre, d, radius)
        z = first
        if first < last:
            middle = nearest_to(origin - centre, d)
            z, last = clip_ray(start, along, boxes, sizes, among, sides, middle, first, last)
        motion(start, along, moves)
        pace = step / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        best = 0.0
        for _ in range(int(MOST_POINTS / FINE)):  # a step that is lost in z's rounding would never end
            if not z <= last or best >= enough[n]:
                break
            seen, share, free = 0, 1.0, pace
            for k in range(count):
                v = order[k]
                px, edge, w = beside(z, v, start, along, distance, sizes)
                if px == -np.inf:
                    continue
                seen += 1
                share = min(share, 0.5 - px)
                if share <= best:
                    px = min(0.9 * (px - 0.5), edge)
                    free = max(free, stride(px, 1.0, w, v, along, moves)) if px > 0 else free
                    order[k], order[0] = order[0], v
                    break
            if share > best and seen >= min(WITNESSES, count):
                best = share
            z += free
        out[n] = max(out[n], min(best, 1.0))
    return out
