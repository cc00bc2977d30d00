"""The surfaces of all views made one: every view's depth is weighed against what the other views measured there.

Two views that are matched apart from each other disagree by a pixel here and by centimetres there, and a picture drawn
from both shows a nose twice. Each view's surface is therefore drawn into the others as a mesh. Along a pixel's ray
every view then has at most one candidate; the one that most others support, and that fewest see through, is averaged
with its supporters (Merrell et al., "Real-time visibility-based fusion of depth maps", 2007).
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.depth.algorithms.scene import Geometry, Maps
from posegaussian.stages.geometry.pairs import MAX_ANGLE, angle_at, far_apart
from posegaussian.stages.matching.bounds import inverse
from posegaussian.stages.matching.fuse import transfer

APART = 80.0
"""Degrees at the subject between views whose surfaces are compared: beyond, they share next to nothing that nearer ones
do not know better, and an uneven ring of eight loses 0.5 dB by those 105 degrees apart. Of views that stand far apart,
which have no nearer ones, all that may be matched are (docs/measurements/rigs.md)."""
TOLERANCE = 2.0
"""Px of motion in the neighbour that moves most, within which candidates support each other."""
STEEP = 8.0
"""Depth between neighbouring pixels, over the footprint of a pixel, from which on they are two surfaces."""
LARGEST = 24
"""Px of a triangle's bounding box: what is stretched wider was seen too flatly to say anything."""
THROUGH = 2.0
"""Tolerances by which a surface must lie behind a candidate for a view to see through it."""
FARTHEST = 1e6
"""Px beside a picture beyond which a point cannot be in it."""


def agreed(geometry: Geometry, maps: Maps, limits: Maps) -> Maps:
    """Depth and confidence [h, w] by view, each weighed against the others' as drawn into it.

    `limits`: nearest and farthest depth of the hull by view; nothing moves out of it. What has no depth keeps none.
    """
    rig, centre = geometry.rig, geometry.centre
    inverses = {v: inverse(z) for v, (z, _) in maps.items()}
    widest, out = MAX_ANGLE if far_apart(rig, geometry.views) else APART, {}
    for v in geometry.views:
        pixel = geometry.pixel(v)
        others = [k for k in geometry.views if k != v and angle_at(centre, rig.centres[v], rig.centres[k]) <= widest]
        if not others or not pixel > 0:
            out[v] = maps[v]
            continue
        drawn = [
            _drawn(inverses[k], maps[k][1], transfer(rig, k, v), 1 / float(rig.intrinsics[k, 0, 0]), inverses[v] > 0)
            for k in others
        ]
        found, trust = _weighed(
            inverses[v],
            maps[v][1],
            np.stack([d[0] for d in drawn]),
            np.stack([d[1] for d in drawn]),
            np.stack([transfer(rig, v, k) for k in others]),
            np.stack([inverses[k] for k in others]),
            np.stack([maps[k][1] for k in others]),
            pixel,
        )
        near, far = limits[v]
        depth = np.clip(inverse(found), near, np.maximum(near, far))
        out[v] = np.where(found != inverses[v], depth, maps[v][0]).astype(np.float32), trust
    return out


@compiled
def _drawn(
    surface: np.ndarray, confidence: np.ndarray, into: np.ndarray, footprint: float, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and confidence [h, w] float32 of another view's surface [h, w], 1/m, as a view sees it, nearest
    first; 0 where it sees none.

    `into` [3, 4] takes (x z, y z, z, 1) of the other to the view's homogeneous pixels; `footprint`: 1 / focal length.
    A triangle that is stretched loses confidence with its size.
    """
    height, width = surface.shape
    rows, columns = wanted.shape
    at = np.zeros((height, width, 3), np.float32)
    for i in range(height):
        for j in range(width):
            if surface[i, j] > 0:
                w = into[2, 0] * j + into[2, 1] * i + into[2, 2] + into[2, 3] * surface[i, j]
                x = into[0, 0] * j + into[0, 1] * i + into[0, 2] + into[0, 3] * surface[i, j]
                y = into[1, 0] * j + into[1, 1] * i + into[1, 2] + into[1, 3] * surface[i, j]
                if w > 1e-9 and abs(x) < FARTHEST * w and abs(y) < FARTHEST * w:
                    at[i, j, 0], at[i, j, 1], at[i, j, 2] = x / w, y / w, surface[i, j] / w
    out, trust = np.zeros(wanted.shape, np.float32), np.zeros(wanted.shape, np.float32)
    for i in range(height - 1):
        for j in range(width - 1):
            for half in range(2):
                # Upper left and lower right triangle of four pixels, both turning the same way.
                a0, a1 = (i, j) if half == 0 else (i + 1, j + 1)
                b0, b1 = (i, j + 1) if half == 0 else (i + 1, j)
                c0, c1 = (i + 1, j) if half == 0 else (i, j + 1)
                za, zb, zc = at[a0, a1, 2], at[b0, b1, 2], at[c0, c1, 2]
                if za <= 0 or zb <= 0 or zc <= 0:
                    continue
                sa, sb, sc = surface[a0, a1], surface[b0, b1], surface[c0, c1]
                low, high = min(sa, min(sb, sc)), max(sa, max(sb, sc))
                if high - low > STEEP * footprint * low:
                    continue
                xa, ya, xb, yb, xc, yc = (
                    at[a0, a1, 0],
                    at[a0, a1, 1],
                    at[b0, b1, 0],
                    at[b0, b1, 1],
                    at[c0, c1, 0],
                    at[c0, c1, 1],
                )
                area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
                if area <= 1e-3:
                    continue  # seen from behind
                left, right = max(np.ceil(min(xa, min(xb, xc))), 0.0), min(np.floor(max(xa, max(xb, xc))), columns - 1)
                top, bottom = max(np.ceil(min(ya, min(yb, yc))), 0.0), min(np.floor(max(ya, max(yb, yc))), rows - 1)
                if right - left > LARGEST or bottom - top > LARGEST:
                    continue
                sure = min(confidence[a0, a1], min(confidence[b0, b1], confidence[c0, c1])) / max(1.0, area)
                for y in range(int(top), int(bottom) + 1):
                    for x in range(int(left), int(right) + 1):
                        if not wanted[y, x]:
                            continue
                        s = ((xc - xb) * (y - yb) - (yc - yb) * (x - xb)) / area
                        t = ((xa - xc) * (y - yc) - (ya - yc) * (x - xc)) / area
                        u = 1 - s - t
                        if s < -1e-4 or t < -1e-4 or u < -1e-4:
                            continue
                        here = s * za + t * zb + u * zc
                        if here > out[y, x]:
                            out[y, x], trust[y, x] = here, sure
    return out, trust


@compiled
def _word(
    z: float, i: int, j: int, into: np.ndarray, surface: np.ndarray, confidence: np.ndarray, reach: float
) -> float:
    """What another view says of a pixel's point at depth z: its confidence where its surface passes within `reach`,
    1/m, less the farther; minus its confidence where it sees through the point; 0 where it does not see it.

    The nine pixels around the point's picture are asked: a slanted surface does not contradict itself, and a body's rim
    is not what lies beside it.
    """
    w = z * (into[2, 0] * j + into[2, 1] * i + into[2, 2]) + into[2, 3]
    if w <= 1e-6:
        return 0.0
    x = (z * (into[0, 0] * j + into[0, 1] * i + into[0, 2]) + into[0, 3]) / w
    y = (z * (into[1, 0] * j + into[1, 1] * i + into[1, 2]) + into[1, 3]) / w
    if not (x > -0.5 and y > -0.5 and x < surface.shape[1] - 0.5 and y < surface.shape[0] - 0.5):
        return 0.0
    row, column = int(np.rint(y)), int(np.rint(x))
    best, through, hidden = 0.0, 0.0, False
    for r in range(max(row - 1, 0), min(row + 2, surface.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, surface.shape[1])):
            if surface[r, c] > 0:
                apart = (surface[r, c] - 1 / w) / reach
                best = max(best, confidence[r, c] * (1 - apart * apart))
                through = max(through, confidence[r, c])
                hidden = hidden or apart > -THROUGH
    return best if best > 0 or hidden else -through


@compiled
def _weighed(
    own: np.ndarray,
    confidence: np.ndarray,
    drawn: np.ndarray,
    trust: np.ndarray,
    transfers: np.ndarray,
    surfaces: np.ndarray,
    sure: np.ndarray,
    pixel: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and confidence [h, w] of a view, from its own and K others' drawn into it, [K, h, w], 1/m.

    `transfers` [K, 3, 4] and `surfaces`, `sure` [K, h, w] are the others' own pictures, which are asked about every
    candidate; `pixel`: 1/metres for a px.
    """
    count, (height, width) = len(drawn), own.shape
    out, trusted = own.copy(), confidence.copy()
    values, weights, scores = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count + 1)
    reach = TOLERANCE * pixel
    for i in range(height):
        for j in range(width):
            if own[i, j] <= 0:
                continue
            values[0], weights[0], n = own[i, j], confidence[i, j], 1
            for k in range(count):
                if drawn[k, i, j] > 0:
                    values[n], weights[n] = drawn[k, i, j], trust[k, i, j]
                    n += 1
            if n == 1:
                continue
            for m in range(n):
                apart = (values[m] - own[i, j]) / reach
                scores[m] = confidence[i, j] * max(0.0, 1 - apart * apart)
                for k in range(count):
                    scores[m] += _word(1 / values[m], i, j, transfers[k], surfaces[k], sure[k], reach)
            best = int(np.argmax(scores[:n]))
            total, weight = 0.0, 0.0
            for o in range(n):
                apart = (values[o] - values[best]) / reach
                share = weights[o] * max(0.0, 1 - apart * apart)
                total += share * values[o]
                weight += share
            if weight > 0:
                out[i, j] = total / weight
                trusted[i, j] = max(confidence[i, j], min(1.0, weight / 2)) if best == 0 else min(1.0, weight / 2)
    return out, trusted
