"""Evening out the noise of a matched surface without bending it or bridging its edges."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.matching.bounds import inverse

RADIUS = 2
"""Px of the neighbourhood."""
SPREAD = 1.3
"""Standard deviation of the weights over the neighbourhood, px."""
JUMP = 8.0
"""Px of disparity between neighbours of two surfaces."""


def even(depth: np.ndarray, pixel: float, tolerance: float) -> np.ndarray:
    """Depth [h, w] float32 with the noise between neighbouring pixels averaged away, 0 where it is 0.

    Args:
        depth: [h, w] float32, metres, 0 = no surface.
        pixel: 1/metres of inverse depth that move a point by one px in the neighbour that moves most.
        tolerance: px of disparity between a pixel and its surroundings that are still noise.

    Neighbours come in pairs opposite each other, whose mean is that of the pixel itself on any plane (inverse depth is
    linear in pixels on a plane), so slopes stay as they are; a pair counts by exp(-((mean - own) / tolerance)^2 / 2)
    and not across a jump.
    """
    if not pixel > 0 or not np.isfinite(pixel):
        return depth
    return inverse(_even(inverse(depth), np.float32(JUMP * pixel), np.float32(1 / (tolerance * pixel))))


@compiled
def _even(surface: np.ndarray, jump: np.float32, sharpness: np.float32) -> np.ndarray:
    height, width = surface.shape
    out = np.zeros_like(surface)
    for i in range(height):
        for j in range(width):
            own = surface[i, j]
            if own <= 0:
                continue
            moved, weights = np.float32(0), np.float32(1)
            for di in range(RADIUS + 1):
                for dj in range(-RADIUS, RADIUS + 1):
                    if di == 0 and dj <= 0:
                        continue
                    a, b, c, d = i + di, j + dj, i - di, j - dj
                    if c < 0 or a >= height or b < 0 or d < 0 or b >= width or d >= width:
                        continue
                    one, other = surface[a, b], surface[c, d]
                    if one <= 0 or other <= 0 or abs(one - own) > jump or abs(other - own) > jump:
                        continue
                    apart = np.float32(0.5) * (one + other) - own
                    x = apart * sharpness
                    weight = np.float32(2 * np.exp(-0.5 * (x * x + (di * di + dj * dj) / (SPREAD * SPREAD))))
                    moved += weight * apart
                    weights += weight
            out[i, j] = own + moved / weights
    return out
