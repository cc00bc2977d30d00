"""Which vertices light from one direction reaches: a depth picture taken from there, compared with a little slack."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.raster import rasterize

_FAR = 200.0
"""Metres from which the picture is taken; at that distance perspective is below the slack."""
SLACK = 0.012
"""Metres a vertex may lie behind what is seen, and by which it is moved out of its own surface."""


def reached(vertices: np.ndarray, normals: np.ndarray, tris: np.ndarray, towards: np.ndarray, size: int) -> np.ndarray:
    """[V] share 0..1 of parallel light from direction `towards` [3] (unit) that reaches each vertex.

    vertices [V, 3] metres, normals [V, 3] unit; `size` is the side of the depth picture in texels. The share is the
    bilinear mean of four comparisons, which softens the shadow's edge over one texel.
    """
    helper = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    frame = np.stack([right, up, -towards])
    seen = vertices @ frame.T
    low, high = seen[:, :2].min(axis=0) - 0.05, seen[:, :2].max(axis=0) + 0.05
    scale = size / float((high - low).max())
    picture = np.column_stack([(seen[:, :2] - low) * scale, seen[:, 2] + _FAR])
    depth = rasterize(picture, tris, size, size, 1)[0]
    out = (vertices + SLACK * normals) @ frame.T
    return _compared(np.column_stack([(out[:, :2] - low) * scale - 0.5, out[:, 2] + _FAR - SLACK]), depth)


@compiled
def _compared(points: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """[V] share of the four texels around each point (x, y, z) that are not in front of it, bilinear."""
    size = len(depth)
    out = np.zeros(len(points))
    for v in range(len(points)):
        x0, y0 = math.floor(points[v, 0]), math.floor(points[v, 1])
        fx, fy = points[v, 0] - x0, points[v, 1] - y0
        for dy in range(2):
            for dx in range(2):
                there = depth[min(max(int(y0) + dy, 0), size - 1), min(max(int(x0) + dx, 0), size - 1)]
                if points[v, 2] <= there:
                    out[v] += (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy)
    return out
