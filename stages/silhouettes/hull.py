"""The visual hull seen from one view: the nearest and the farthest point of every pixel's ray that all masks allow.

Image-based: no voxels. For each foreground pixel the ray is first clipped, exactly, to the boxes around the other
views' masks, then walked in steps of about one pixel of motion in the other views, or farther where a silhouette is
farther away; both ends are refined by bisection (Matusik et al., "Image-based visual hulls", 2000, find the same
intervals on the epipolar lines).

A view carves only what it can see: a point beside its picture or behind its camera stays, and a view whose mask is
empty says nothing. A point that fewer than two other views see (or the only other one) is not part of the hull, because
too little speaks for it: the opposite camera of a ring sees a ray from end to end and carves none of it.

A ray without a hull is tried again: with silhouettes a little wider, for masks and calibrations that are off, then
against the vote of one view, whose mask may lack a limb. Masks that are wrong as a whole are found by
`posegaussian.stages.silhouettes.agreement`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.distance import box, distance_to_foreground, within
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres, to_integer_centres
from posegaussian.storage.model.masks import foreground

REACH = 0.9
"""Radius of the searched sphere over the distance of the nearest camera: the sphere holds no camera."""
WITNESSES = 2
"""Other views that must see a point of the hull, where there are as many."""
TOLERANCE = (0.0, 1.5)
"""Px a point may lie outside another view's silhouette; the second value only for rays without a hull at the first."""
OUTVOTED = 4
"""Other views, at least, of which one may be overruled for a ray that has no hull otherwise."""
BISECTIONS = 4
"""Halvings of the last step: a sixteenth of a pixel."""
MOST_POINTS = 2**15
"""Points of a ray that are looked at: about as many as a ray has px in the largest pictures. Cameras of another
scale than the scene would walk for ever."""
OBLIQUE = 1.5
"""Px by which a point moves for a metre sideways, over focal length / depth, at most: 48 degrees off the axis."""


def searched_radius(rig: Rig, views: list[int], centre: np.ndarray) -> float:
    """Metres: radius of the sphere around `centre` [3] in which the subject of these views is searched."""
    return REACH * float(np.linalg.norm(rig.centres[views] - centre, axis=1).min())


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """What S views say about where the subject is, prepared once for rays from anywhere."""

    views: tuple[int, ...]
    """S views with some foreground."""
    distance: np.ndarray
    """[S, h, w] float32: px outside the silhouette, see `distance_to_foreground`."""
    projections: np.ndarray
    """[S, 3, 4] world metres to homogeneous px, integer centres."""
    boxes: np.ndarray
    """[S, 4] x0, y0, x1, y1 in integer-centre px: the part of a picture outside which it carves everything it sees."""
    sizes: np.ndarray
    """[S, 2] (width, height) px."""
    focals: np.ndarray
    """[S] px by which a point moves for a metre sideways at a metre of depth, at most."""
    pixels: np.ndarray
    """[S] metres of a px at the centre."""
    centre: np.ndarray
    """[3] middle of what is searched, world metres."""
    radius: float
    """Metres around it that are searched."""

    @classmethod
    def of(
        cls,
        rig: Rig,
        masks: Mapping[int, np.ndarray],
        centre: np.ndarray,
        radius: float,
        tolerance: float = TOLERANCE[1],
    ) -> Silhouettes:
        """Of masks [h, w] uint8 by view index; the pictures lie at the top left of the arrays and `rig.size` says how
        large they are.

        `tolerance`: px beyond a silhouette that will be asked for, at most.
        """
        views = [v for v in sorted(masks) if foreground(masks[v][: rig.size[v, 1], : rig.size[v, 0]]).any()]
        shape = next((m.shape for m in masks.values()), (0, 0))
        distance = (
            np.stack([distance_to_foreground(masks[v], rig.size[v]) for v in views])
            if views
            else np.zeros((0, *shape), np.float32)
        )
        boxes = np.array([box(masks[v], rig.size[v], tolerance) for v in views]).reshape(-1, 4)
        pixels = np.linalg.norm(rig.centres[views] - centre, axis=1) / rig.intrinsics[views, 0, 0]
        projections = to_integer_centres(rig.intrinsics[views]) @ rig.world_to_camera[views, :3]
        return cls(
            tuple(views),
            distance,
            projections,
            boxes,
            rig.size[views].astype(np.float64),
            OBLIQUE * rig.intrinsics[views][:, [0, 1], [0, 1]].max(axis=1, initial=0),
            pixels,
            centre,
            radius,
        )

    @property
    def pixel(self) -> float:
        """Metres from one point of a ray to the next: a px at the centre of the sharpest view, or more where the
        sphere would take more than `MOST_POINTS`."""
        return self._pixel_among(np.arange(len(self.views)))

    def _pixel_among(self, among: np.ndarray) -> float:
        """The same of those of some views alone."""
        return max(float(self.pixels[among].min()), 2 * self.radius / MOST_POINTS)

    def _but(self, without: int | None) -> np.ndarray:
        """Indices of the silhouettes but that of a view, whether it has one or not."""
        return np.array([i for i, v in enumerate(self.views) if v != without], np.int64)

    @cached_property
    def whole(self) -> np.ndarray:
        """[S, h, w] float32: px by which a pixel lies, at least, within the part of a mask that carves nothing off it;
        beside it, as far as it lies outside the silhouette, negative."""
        return within(self.distance)

    def wider(self, px: float) -> Silhouettes:
        """The same, each wider by some px of its own picture."""
        low, high = self.boxes[:, :2] - px, self.boxes[:, 2:] + px
        boxes = np.concatenate([np.maximum(low, 0), np.minimum(high, self.sizes - 1)], axis=1)
        return replace(self, distance=self.distance - np.float32(px), boxes=boxes)

    def kept(self, views: set[int]) -> Silhouettes:
        """Those of the given views alone."""
        chosen = [i for i, v in enumerate(self.views) if v in views]
        parts: dict[str, Any] = {
            n: np.ascontiguousarray(getattr(self, n)[chosen])
            for n in ("distance", "projections", "boxes", "sizes", "focals", "pixels")
        }
        return replace(self, views=tuple(self.views[i] for i in chosen), **parts)

    def joined(self, other: Silhouettes) -> Silhouettes:
        """These and those of other views, prepared around the same centre."""
        parts: dict[str, Any] = {
            n: np.concatenate([getattr(self, n), getattr(other, n)])
            for n in ("distance", "projections", "boxes", "sizes", "focals", "pixels")
        }
        return replace(self, views=(*self.views, *other.views), **parts)

    def ends(
        self,
        origin: np.ndarray,
        directions: np.ndarray,
        tolerance: tuple[float, float] = TOLERANCE,
        votes: bool = True,
        without: int | None = None,
    ) -> np.ndarray:
        """[N, 2] depth at which rays origin [3] + depth * directions [N, 3] enter and leave the hull, 0 where they miss
        it.

        Rays that miss it are tried again with the second tolerance, px, then, with `votes`, against one view. The hull
        is that of the views but the one `without` which it is asked for.
        """
        tries = [(t, 0) for t in dict.fromkeys(tolerance)]
        if votes and len(self._but(without)) >= OUTVOTED:
            tries.append((tolerance[1], 1))
        return self._marched(origin, directions, tries, without, True)

    def met(self, origin: np.ndarray, directions: np.ndarray, tolerance: float, without: int | None) -> np.ndarray:
        """[N] bool: which rays origin [3] + depth * directions [N, 3] the hull of the views but one leaves something
        of; `tolerance` px beyond the silhouettes."""
        return self._marched(origin, directions, [(tolerance, 0)], without, False)[:, 0] > 0

    def _marched(
        self,
        origin: np.ndarray,
        directions: np.ndarray,
        tries: list[tuple[float, int]],
        without: int | None,
        far: bool,
    ) -> np.ndarray:
        """[N, 2] as `_march` finds it."""
        out, among = np.zeros((len(directions), 2)), self._but(without)
        if len(among) and len(directions):
            _march(
                origin,
                directions,
                self.distance,
                self.projections,
                self.boxes,
                self.sizes,
                self.centre,
                self.radius,
                self._pixel_among(among),
                tries,
                among,
                far,
                out,
            )
        return out


def visual_hull(
    rig: Rig,
    view: int,
    mask: np.ndarray,
    silhouettes: Silhouettes,
    tolerance: tuple[float, float] = TOLERANCE,
    votes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Near and far depth [h, w] float32 of the hull along each foreground ray of `view`, metres along its optical axis.

    `mask` [h, w] uint8 is the view's own; `silhouettes` may hold the view itself, which cannot carve its own rays.
    `tolerance` in px lets a point lie that far outside another view's silhouette; rays that miss the hull are tried
    again with the second value, then, with `votes`, against one view, so that errors of calibration and matting do not
    eat limbs. Both maps are 0 where the pixel is background and where no point of its ray is in the hull.
    """
    own = foreground(mask)
    near, far = np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
    rows, columns = np.nonzero(own)
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[view], rig.world_to_camera[view]
    )
    near[rows, columns], far[rows, columns] = silhouettes.ends(origin, directions, tolerance, votes, without=view).T
    return near, far


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
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
    if x < 0 or y < 0 or x > right or y > bottom:
        return -np.inf, 0.0, 0.0
    column, row, one = np.uint32(min(x, right - 0.5)), np.uint32(min(y, bottom - 0.5)), np.uint32(1)
    a, b = x - column, y - row
    top = distance[v, row, column] + a * (distance[v, row, column + one] - distance[v, row, column])
    low = distance[v, row + one, column] + a * (distance[v, row + one, column + one] - distance[v, row + one, column])
    return top + b * (low - top), min(min(x, y), min(right - x, bottom - y)), w


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def stride(px: float, ahead: float, w: float, v: int, along: np.ndarray, moves: np.ndarray) -> float:
    """By how much depth must grow (`ahead` 1) or fall (-1) until a ray's point, w in front of view v, has moved by px
    there: |z' - z| moves / (w w') with w' its distance then. inf where it never does."""
    slower = moves[v] - ahead * px * w * along[v, 2]
    return px * w * w / slower if slower > 0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
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


@njit(cache=True, nogil=True)
def _part(
    start: np.ndarray, along: np.ndarray, x0: float, y0: float, x1: float, y1: float, z0: float, z1: float
) -> tuple[float, float]:
    """The part of [z0, z1] that one view sees inside a box of its picture; a box is convex, so there is one part.
    Empty: (inf, -inf)."""
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
def _witnessed(seen: np.ndarray, z0: float, z1: float) -> tuple[float, float]:
    """The part of [z0, z1] between whose ends enough views see the ray, each a part `seen` [S, 2] of it."""
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
    return (max(z0, first), min(z1, last)) if len(seen) < WITNESSES else (max(z0, second), min(z1, last_but_one))


@njit(cache=True, nogil=True)
def _watched(
    start: np.ndarray, along: np.ndarray, sizes: np.ndarray, among: np.ndarray, z0: float, z1: float
) -> tuple[float, float]:
    """The part of [z0, z1] that enough of the views `among` all see to be of the hull, whatever they carve."""
    seen = np.empty((len(among), 2))
    for n in range(len(among)):
        v = among[n]
        seen[n, 0], seen[n, 1] = _part(start[v], along[v], 0.0, 0.0, sizes[v, 0] - 1, sizes[v, 1] - 1, z0, z1)
    return _witnessed(seen, z0, z1)


@njit(cache=True, nogil=True)
def clip_ray(
    start: np.ndarray,
    along: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    among: np.ndarray,
    z0: float,
    z1: float,
) -> tuple[float, float]:
    """The part of [z0, z1] that can hold the hull of the views `among` all: seen by enough of them, and in the box of
    all that see its ends."""
    views = len(among)
    seen, kept = np.empty((views, 2)), np.empty((views, 2))
    for n in range(views):
        v = among[n]
        seen[n, 0], seen[n, 1] = _part(start[v], along[v], 0.0, 0.0, sizes[v, 0] - 1, sizes[v, 1] - 1, z0, z1)
        kept[n, 0], kept[n, 1] = _part(start[v], along[v], boxes[v, 0], boxes[v, 1], boxes[v, 2], boxes[v, 3], z0, z1)
    z0, z1 = _witnessed(seen, z0, z1)
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
    tries: list[tuple[float, int]],
    among: np.ndarray,
    far: bool,
    ends: np.ndarray,
) -> None:
    """Fill ends [N, 2] with near and far depth of each ray [N, 3], 0 where the ray has no hull.

    `pixel` is metres a step; `tries` are (tolerance px, views overruled), one after the other until there is a hull;
    `among` are the views that it is the hull of. Without `far` the near depth stands for the far one.
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
        clipped = clip_ray(start, along, boxes, sizes, among, first, last)
        for how in tries:
            # A view that is overruled does not clip either, but to where enough others look.
            z0, z1 = _watched(start, along, sizes, among, first, last) if how[1] else clipped
            if z1 <= z0:
                continue
            near = _end(z0, step, z1, start, along, moves, distance, sizes, order, how)
            if near >= 0:
                ends[n, 0] = near
                ends[n, 1] = near
                if far:
                    # The way back may stride over a hull thinner than a step: then it is as thick as the point found.
                    ends[n, 1] = max(near, _end(z1, -step, near, start, along, moves, distance, sizes, order, how))
                break


@njit(cache=True, nogil=True)
def into_views(
    origin: np.ndarray, d: np.ndarray, projections: np.ndarray, start: np.ndarray, along: np.ndarray
) -> None:
    """Fill start and along [S, 3]: the point at depth z of a ray is start + z along in the views' homogeneous px."""
    for v in range(projections.shape[0]):
        for i in range(3):
            p = projections[v, i]
            start[v, i] = p[0] * origin[0] + p[1] * origin[1] + p[2] * origin[2] + p[3]
            along[v, i] = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]


@njit(cache=True, nogil=True)
def motion(start: np.ndarray, along: np.ndarray, moves: np.ndarray) -> None:
    """Fill moves [S]: between depths z and z', w and w' in front of a view, a ray's point moves by moves |z' - z| / (w
    w') px there."""
    for v in range(len(moves)):
        across = along[v, 0] * start[v, 2] - start[v, 0] * along[v, 2]
        down = along[v, 1] * start[v, 2] - start[v, 1] * along[v, 2]
        moves[v] = math.sqrt(across * across + down * down)


@njit(cache=True, nogil=True)
def in_sphere(to: np.ndarray, d: np.ndarray, radius: float) -> tuple[float, float]:
    """Depths at which a ray along d [3] enters and leaves a sphere, `to` [3] from the sphere's middle to the ray's
    origin; (1, 0) where it misses it."""
    a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    b = d[0] * to[0] + d[1] * to[1] + d[2] * to[2]
    inside = b * b - a * (to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - radius * radius)
    if inside <= 0:
        return 1.0, 0.0
    return max((-b - math.sqrt(inside)) / a, 1e-3), (-b + math.sqrt(inside)) / a
