"""A box-shaped room: wooden floor, painted walls with a door and shelves of noise, a ceiling with lamps."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.texture import noise


@compiled
def room_light(centre: np.ndarray, directions: np.ndarray, side: float, ceiling: float) -> np.ndarray:
    """[h, w, 3] float32 linear light of the room's inside along rays;
    directions [h, w, 3] in the world, centre [3] inside."""
    h, w = directions.shape[:2]
    out = np.empty((h, w, 3), dtype=np.float32)
    for i in range(h):
        for j in range(w):
            best, axis = 1e30, 2
            for k in range(3):
                d = directions[i, j, k]
                if d == 0.0:
                    continue
                wall = (0.5 * side if d > 0.0 else -0.5 * side) if k < 2 else (ceiling if d > 0.0 else 0.0)
                t = (wall - centre[k]) / d
                if 0.0 < t < best:
                    best, axis = t, k
            x, y, z = (
                centre[0] + best * directions[i, j, 0],
                centre[1] + best * directions[i, j, 1],
                centre[2] + best * directions[i, j, 2],
            )
            if axis == 2:
                if z < 0.5 * ceiling:
                    plank = math.floor(y / 0.14)
                    grain = noise(x / 0.5 + 7.7 * plank, y / 0.03, 0.5) - 0.5
                    tone = (
                        0.8
                        + 0.35 * (noise(plank * 3.1, math.floor(x / 1.3 + 0.37 * plank) * 2.3, 1.5) - 0.5)
                        + 0.3 * grain
                    )
                    if y / 0.14 - plank < 0.03:
                        tone *= 0.5
                    far = math.sqrt(x * x + y * y)
                    dim = 0.55 + 0.45 * min(1.0, far / 1.2)
                    out[i, j, 0], out[i, j, 1], out[i, j, 2] = 0.30 * tone * dim, 0.19 * tone * dim, 0.11 * tone * dim
                else:
                    lamp = 1.0 if (abs(x) % 3.0 < 0.9 and abs(y) % 3.0 < 0.25) else 0.0
                    out[i, j, 0], out[i, j, 1], out[i, j, 2] = 0.5 + 0.5 * lamp, 0.5 + 0.5 * lamp, 0.48 + 0.5 * lamp
                continue
            u = y if axis == 0 else x
            tone = (
                0.9 + 0.12 * (noise(u / 0.8, z / 0.8, 3.0 * axis) - 0.5) + 0.04 * (noise(u / 0.05, z / 0.05, 9.0) - 0.5)
            )
            r, g, b = 0.42 * tone, 0.44 * tone, 0.42 * tone
            if z < 0.10:
                r, g, b = 0.12, 0.10, 0.09
            elif axis == 0 and abs(u - 1.6) < 0.48 and z < 2.05:
                r, g, b = 0.20 * tone, 0.13 * tone, 0.08 * tone
            elif axis == 1 and abs(u) < 1.8 and 0.5 < z < 2.1:
                book = noise(math.floor(u / 0.055) * 1.7, math.floor(z / 0.32) * 5.3, 2.0)
                other = noise(math.floor(u / 0.055) * 3.7, math.floor(z / 0.32) * 2.9, 8.0)
                shelf = z / 0.32 - math.floor(z / 0.32)
                if shelf < 0.08:
                    r, g, b = 0.25, 0.18, 0.12
                elif shelf > 0.55 + 0.4 * book:
                    r, g, b = 0.03, 0.03, 0.03
                else:
                    r, g, b = 0.06 + 0.4 * book * other, 0.05 + 0.3 * other * (1.0 - book), 0.05 + 0.35 * (1.0 - other)
            corner = 0.7 + 0.3 * min(1.0, (0.5 * side - abs(u)) / 1.0)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = r * corner, g * corner, b * corner
    return out
