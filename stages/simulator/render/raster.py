"""A z-buffer rasterizer: which triangle a ray through a point of the picture meets first, and how far along the optical
axis.

Pictures follow the project's pixel centres: sample (i, j) of a picture with S samples a side lies at ((j + 0.5) / S,
(i + 0.5) / S) px. A mesh may lie in any order: an edge is evaluated from its lower vertex index to its higher one, so
two triangles that share it leave no gap and no order decides; of two triangles at the same depth the one with the lower
vertex indices is seen. Triangles that reach behind `NEAR` are left out whole.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled

NEAR = 0.05
"""Metres before the camera within which nothing is drawn."""


@compiled
def _edge(p: np.ndarray, a: int, b: int, x: float, y: float) -> float:
    """Twice the signed area of (a, b, (x, y)); exactly the negative of the same edge walked the other way."""
    if a < b:
        return (p[b, 0] - p[a, 0]) * (y - p[a, 1]) - (p[b, 1] - p[a, 1]) * (x - p[a, 0])
    return -((p[a, 0] - p[b, 0]) * (y - p[b, 1]) - (p[a, 1] - p[b, 1]) * (x - p[b, 0]))


@compiled
def shares(p: np.ndarray, tri: np.ndarray, x: float, y: float) -> tuple[float, float, float]:
    """Perspective-correct shares of a triangle's corners at a point of the picture; they sum to 1.

    p [V, 3] (u px, v px, depth m); tri [3]. In the picture 1/depth is linear, so each linear share is weighted by it.
    """
    e0, e1, e2 = _edge(p, tri[1], tri[2], x, y), _edge(p, tri[2], tri[0], x, y), _edge(p, tri[0], tri[1], x, y)
    a, b, c = e0 / p[tri[0], 2], e1 / p[tri[1], 2], e2 / p[tri[2], 2]
    s = a + b + c
    return a / s, b / s, c / s


@compiled
def _before(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether triangle a comes before b by its vertex indices."""
    for k in range(3):
        if a[k] != b[k]:
            return bool(a[k] < b[k])
    return False


@compiled
def rasterize(p: np.ndarray, tris: np.ndarray, width: int, height: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth [h S, w S] float64 (inf = none) and index [h S, w S] int32 (-1 = none) of the first triangle at every
    sample.

    p [V, 3] (u px, v px, depth m) of the vertices; tris [T, 3] int32. Both sides of a triangle are seen. The depth is
    that of the triangle's plane at the sample.
    """
    w, h = width * samples, height * samples
    depth = np.full((h, w), np.inf)
    index = np.full((h, w), -1, dtype=np.int32)
    for t in range(len(tris)):
        a, b, c = tris[t, 0], tris[t, 1], tris[t, 2]
        if p[a, 2] < NEAR or p[b, 2] < NEAR or p[c, 2] < NEAR:
            continue
        area = _edge(p, a, b, p[c, 0], p[c, 1])
        if area == 0.0:
            continue
        j0 = max(0, math.ceil(min(p[a, 0], p[b, 0], p[c, 0]) * samples - 0.5))
        j1 = min(w - 1, math.floor(max(p[a, 0], p[b, 0], p[c, 0]) * samples - 0.5))
        i0 = max(0, math.ceil(min(p[a, 1], p[b, 1], p[c, 1]) * samples - 0.5))
        i1 = min(h - 1, math.floor(max(p[a, 1], p[b, 1], p[c, 1]) * samples - 0.5))
        za, zb, zc = 1.0 / p[a, 2], 1.0 / p[b, 2], 1.0 / p[c, 2]
        for i in range(i0, i1 + 1):
            y = (i + 0.5) / samples
            for j in range(j0, j1 + 1):
                x = (j + 0.5) / samples
                ea, eb, ec = _edge(p, b, c, x, y), _edge(p, c, a, x, y), _edge(p, a, b, x, y)
                if (ea >= 0.0 and eb >= 0.0 and ec >= 0.0) or (ea <= 0.0 and eb <= 0.0 and ec <= 0.0):
                    s = ea + eb + ec
                    if s == 0.0:
                        continue
                    z = s / (ea * za + eb * zb + ec * zc)
                    if z < depth[i, j] or (z == depth[i, j] and _before(tris[t], tris[index[i, j]])):
                        depth[i, j] = z
                        index[i, j] = t
    return depth, index


@compiled
def vertex_normals(vertices: np.ndarray, tris: np.ndarray) -> np.ndarray:
    """[V, 3] unit normals: the area-weighted mean of the triangles around each vertex;
    (0, 0, 1) where there is none."""
    out = np.zeros_like(vertices)
    for t in range(len(tris)):
        a, b, c = tris[t, 0], tris[t, 1], tris[t, 2]
        x = vertices[b] - vertices[a]
        y = vertices[c] - vertices[a]
        n0, n1, n2 = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
        for k in (a, b, c):
            out[k, 0] += n0
            out[k, 1] += n1
            out[k, 2] += n2
    for v in range(len(out)):
        length = math.sqrt(out[v, 0] ** 2 + out[v, 1] ** 2 + out[v, 2] ** 2)
        if length > 0.0:
            out[v] /= length
        else:
            out[v, 2] = 1.0
    return out


@compiled
def flat_normals(camera: np.ndarray, tris: np.ndarray, index: np.ndarray) -> np.ndarray:
    """[h, w, 3] float32 unit normals of the triangles seen, in camera axes and facing the camera; 0 where there is
    none.

    camera [V, 3] vertices in the camera's frame; index [h, w] from `rasterize`.
    """
    out = np.zeros((index.shape[0], index.shape[1], 3), dtype=np.float32)
    for i in range(index.shape[0]):
        for j in range(index.shape[1]):
            t = index[i, j]
            if t < 0:
                continue
            x = camera[tris[t, 1]] - camera[tris[t, 0]]
            y = camera[tris[t, 2]] - camera[tris[t, 0]]
            n0, n1, n2 = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
            length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            if n0 * camera[tris[t, 0], 0] + n1 * camera[tris[t, 0], 1] + n2 * camera[tris[t, 0], 2] > 0.0:
                length = -length
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = n0 / length, n1 / length, n2 / length
    return out
