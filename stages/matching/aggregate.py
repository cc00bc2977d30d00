"""Semi-global aggregation of a cost volume over eight directions, and its sub-pixel minimum.

Hirschmueller, "Stereo processing by semiglobal matching and mutual information" (2008). Labels are offsets from a guide
surface, so the penalties bend the result towards the guide's shape, not towards a plane before the camera.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.matching.cost import FORBIDDEN

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
"""(rows, columns) of a step along each path."""


@compiled
def _step(cost: np.ndarray, before: np.ndarray, small: int, large: int, out: np.ndarray, total: np.ndarray) -> None:
    """One pixel of one path: out [D + 2] from the pixel before [D + 2], both padded by a label at each end;
    adds to total [D]."""
    count = len(cost)
    least = before[1]
    for d in range(2, count + 1):
        least = min(least, before[d])
    leap = least + large
    for d in range(count):
        best = min(min(before[d + 1], leap), min(before[d], before[d + 2]) + small)
        out[d + 1] = cost[d] + best - least
        total[d] += out[d + 1]


@compiled
def aggregate(volume: np.ndarray, mask: np.ndarray, jumps: np.ndarray, small: int, large: int) -> np.ndarray:
    """Sum [h, w, D] uint16 over eight directions of the least cost of a path that ends at a pixel with an offset.

    volume [h, w, D] uint8, mask [h, w] bool; an offset that changes by one label costs `small`, by more `large`. Paths
    do not cross pixels outside the mask, nor from one value of `jumps` [h, w] float32 to one that differs by more than
    1: there two surfaces meet, whose offsets have nothing to do with each other.
    """
    height, width, depth = volume.shape
    total = np.zeros((height, width, depth), np.uint16)
    far = np.int32(1 << 24)
    for direction in range(8):
        di, dj = DIRECTIONS[direction]
        rows, start = (di != 0), (0 if di > 0 or (di == 0 and dj > 0) else 1)
        previous, current = (
            np.full((width + 2, depth + 2), far, np.int32),
            np.full((width + 2, depth + 2), far, np.int32),
        )
        for n in range(height):
            i = n if start == 0 else height - 1 - n
            for m in range(width):
                j = m if (dj >= 0) else width - 1 - m
                if not mask[i, j]:
                    continue
                pi, pj = i - di, j - dj
                linked = 0 <= pi < height and 0 <= pj < width and mask[pi, pj] and abs(jumps[i, j] - jumps[pi, pj]) <= 1
                here = current[j]
                if linked:
                    _step(volume[i, j], previous[pj] if rows else current[pj], small, large, here, total[i, j])
                else:
                    for d in range(depth):
                        here[d + 1] = volume[i, j, d]
                        total[i, j, d] += volume[i, j, d]
            if rows:
                previous, current = current, previous
    return total


@compiled
def minimum(total: np.ndarray, volume: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The label of least total [h, w] float32, with the fraction of a parabola through its neighbours; -1 where no
    offset is allowed."""
    height, width, depth = total.shape
    label = np.full((height, width), np.float32(-1), np.float32)
    for i in range(height):
        for j in range(width):
            best = -1
            for d in range(depth):
                if mask[i, j] and volume[i, j, d] != FORBIDDEN and (best < 0 or total[i, j, d] < total[i, j, best]):
                    best = d
            if best < 0:
                continue
            part = 0.0
            if 0 < best < depth - 1 and volume[i, j, best - 1] != FORBIDDEN and volume[i, j, best + 1] != FORBIDDEN:
                a, b, c = np.int64(total[i, j, best - 1]), np.int64(total[i, j, best]), np.int64(total[i, j, best + 1])
                if a - 2 * b + c > 0:
                    part = min(max(0.5 * (a - c) / (a - 2 * b + c), -0.5), 0.5)
            label[i, j] = best + part
    return label
