"""What other views say about a ray: could the subject be anywhere along it, and do they all see the subject there?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.compiling.compiled import compiled

WITNESSES = 2
"""Other views that must see a point for it to count as confirmed, where there are as many."""


NEAR = 0.45
"""Metres from the nearest joint within which a body lies: outstretched fingers from a wrist, a belly from a hip."""


@dataclass(frozen=True, eq=False)
class Fields:
    """What S other views hold possible and what they saw, on grids of their pictures."""

    possible: np.ndarray
    """[S, h, w] float32: 0..1 that the subject may be at a cell."""
    seen: np.ndarray
    """[S, h, w] float32: 0..1 that the view saw the subject there; negative beside its picture."""
    projections: np.ndarray
    """[S, 3, 4] world metres to homogeneous cells, integer centres."""


def ray_support(
    fields: Fields, origin: np.ndarray, directions: np.ndarray, depths: np.ndarray, joints: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Possible [N] and confirmed [N], 0..1 float32, of rays origin [3] + depth * directions [N, 3], walked at `depths`
    [K].

    Possible is the most, along the ray, of the least that any view holds possible: a view that does not see a point,
    beside its picture or behind its camera, carves nothing. A point that fewer than two views see (or not the only
    other one) is possible only near a joint [J, 3], metres, where there are any. Confirmed is the most of the least
    that was seen, over points near a joint that so many views see; 0 where there are none: far from all joints what
    several views saw meets by chance, on rays that lead past the subject.
    """
    possible, confirmed = np.ones(len(directions), np.float32), np.zeros(len(directions), np.float32)
    if len(fields.projections) and len(depths):
        origin, directions, depths, joints = (
            np.ascontiguousarray(a, dtype=np.float64) for a in (origin, directions, depths, joints)
        )
        maps = (fields.possible, fields.seen, fields.projections)
        _walk(*maps, origin, directions, depths, joints, possible, confirmed)
    return possible, confirmed


@compiled
def _near(x: float, y: float, z: float, joints: np.ndarray) -> bool:
    for j in range(len(joints)):
        if (x - joints[j, 0]) ** 2 + (y - joints[j, 1]) ** 2 + (z - joints[j, 2]) ** 2 < NEAR**2:
            return True
    return len(joints) == 0


@compiled
def _walk(
    possible: np.ndarray,
    seen: np.ndarray,
    projections: np.ndarray,
    origin: np.ndarray,
    directions: np.ndarray,
    depths: np.ndarray,
    joints: np.ndarray,
    out_possible: np.ndarray,
    out_confirmed: np.ndarray,
) -> None:
    views, height, width = possible.shape
    needed = min(WITNESSES, views)
    for n in range(directions.shape[0]):
        best, sure = np.float32(0), np.float32(0)
        for z in depths:
            x, y, w = (
                origin[0] + z * directions[n, 0],
                origin[1] + z * directions[n, 1],
                origin[2] + z * directions[n, 2],
            )
            least, least_seen, witnesses = np.float32(1), np.float32(1), 0
            for v in range(views):
                p = projections[v]
                depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * w + p[2, 3]
                if depth <= 1e-6:
                    continue
                column = np.floor((p[0, 0] * x + p[0, 1] * y + p[0, 2] * w + p[0, 3]) / depth + 0.5)
                row = np.floor((p[1, 0] * x + p[1, 1] * y + p[1, 2] * w + p[1, 3]) / depth + 0.5)
                if column < 0 or row < 0 or column >= width or row >= height:
                    continue
                i, j = int(row), int(column)
                least = min(least, possible[v, i, j])
                if seen[v, i, j] >= 0:
                    witnesses += 1
                    least_seen = min(least_seen, seen[v, i, j])
                if least <= best and least_seen <= sure:
                    break
            if witnesses >= needed and least_seen > sure and _near(x, y, w, joints):
                sure = least_seen
            if least > best and (witnesses >= needed or _near(x, y, w, joints)):
                best = least
            if best >= 1 and sure >= 1:
                break
        out_possible[n], out_confirmed[n] = best, sure
