"""Cloth, skin and hair as solid textures: colour follows from the place on the body at rest, so no seam shows.

Every pattern fades over about 3 mm, the finest noise has cells of 6 mm: at 512 px and two samples a side nothing
aliases.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.raster import rasterize, shares
from posegaussian.stages.simulator.render.texture import noise

PLAIN, STRIPES, CHECKS, DOTS, CAMOUFLAGE, FLORAL, DENIM, SKIN, HAIR, EYE, PRINT = range(11)
PATTERNS = ("plain", "stripes", "checks", "dots", "camouflage", "floral", "denim", "skin", "hair", "eye", "print")


@compiled
def _step(x: float, at: float, width: float) -> float:
    """0 below, 1 above `at`, smooth over `width`."""
    t = min(1.0, max(0.0, (x - at) / width + 0.5))
    return t * t * (3.0 - 2.0 * t)


@compiled
def _octaves(x: float, y: float, z: float, cell: float) -> float:
    """Noise of three scales, the coarsest with cells of `cell` metres; about -1..1."""
    a = noise(x / cell, y / cell, z / cell) - 0.5
    b = noise(2.1 * x / cell + 5.2, 2.1 * y / cell, 2.1 * z / cell) - 0.5
    c = noise(4.3 * x / cell, 4.3 * y / cell + 9.1, 4.3 * z / cell) - 0.5
    return 1.1 * a + 0.6 * b + 0.3 * c


@compiled
def _band(x: float, period: float, share: float) -> float:
    """1 inside the bands that take `share` of every period, 0 outside; edges 3 mm soft."""
    t = abs(x / period - math.floor(x / period) - 0.5) * period
    return 1.0 - _step(t, 0.5 * share * period, 0.003)


@compiled
def _print(x: float, y: float, z: float, scale: float) -> tuple[float, float, float]:
    """A printed picture with the statistics of photographs: opaque leaves of all sizes, the nearer over the farther
    (dead leaves; Lee, Mumford and Huang, IJCV 2001), each with a tone and a gradient of its own."""
    left, second, third, bright = 1.0, 0.0, 0.0, 0.0
    u, v = y + 0.35 * x, z
    for k in range(12):  # sizes come in turns, so that small leaves lie over and under large ones
        cell = scale * (0.45, 1.6, 0.8, 2.6)[k % 4]
        i0, j0 = math.floor(u / cell), math.floor(v / cell)
        for i in range(i0 - 1, i0 + 2):
            for j in range(j0 - 1, j0 + 2):
                p, q, r = float(i), float(j), 7.0 * k  # noise at whole numbers is a hash
                a, b, c, d = noise(p, q, r), noise(p, q, r + 1.0), noise(p, q, r + 2.0), noise(p, q, r + 3.0)
                if k < 10 and a < 0.45:
                    continue  # no leaf in this cell
                du, dv = u - (i + b) * cell, v - (j + c) * cell
                long = 0.35 + 0.75 * d
                turned = du * math.cos(6.3 * a) + dv * math.sin(6.3 * a)
                across = dv * math.cos(6.3 * a) - du * math.sin(6.3 * a)
                far = math.sqrt(turned * turned + across * across * (1.0 + 3.0 * b)) / cell
                cover = left * (1.0 - _step((far - 0.75 * long) * cell, 0.0, 0.003))
                second += cover * _step(noise(p, q, r + 4.0), 0.5, 0.5)
                third += cover * _step(noise(p, q, r + 5.0), 0.6, 0.5)
                bright += cover * (0.35 + 0.9 * noise(p, q, r + 6.0)) * (1.0 + 0.5 * turned / cell)
                left -= cover
        if left < 0.004:
            break
    return second, third, bright + left


@compiled
def _weights(pattern: int, x: float, y: float, z: float, scale: float) -> tuple[float, float, float]:
    """Shares of the second and third colour, and a factor of brightness."""
    fine = 1.0 + 0.10 * _octaves(x, y, z, 0.025) + 0.05 * (noise(x / 0.006, y / 0.006, z / 0.006) - 0.5)
    if pattern == STRIPES:
        return _band(z + 0.004 * _octaves(x, y, z, 0.08), scale, 0.45), 0.0, fine
    if pattern == CHECKS:
        a, b = _band(z, scale, 0.5), _band(y + 0.7 * x, scale, 0.5)
        line = max(_band(z + 0.25 * scale, scale, 0.08), _band(y + 0.7 * x + 0.25 * scale, scale, 0.08))
        return 0.5 * (a + b) * (1.0 - line), line, fine
    if pattern == DOTS:
        row = math.floor(z / scale)
        shift = 0.5 * scale * (row % 2)
        u = y + shift - scale * math.floor((y + shift) / scale) - 0.5 * scale
        v = z - scale * row - 0.5 * scale
        return 1.0 - _step(math.sqrt(u * u + v * v), 0.27 * scale, 0.003), 0.0, fine
    if pattern == CAMOUFLAGE:
        a, b = _octaves(x, y, 0.7 * z, 2.2 * scale), _octaves(x + 7.0, y, 0.7 * z, 1.5 * scale)
        return _step(a, 0.08, 0.05), _step(b, 0.22, 0.05), fine
    if pattern == FLORAL:
        a, b = _octaves(x, y + 3.0, z, scale), _octaves(x + 2.0, y, z + 4.0, 0.7 * scale)
        return _step(a, 0.12, 0.08), _step(b, 0.30, 0.08), fine
    if pattern == DENIM:
        worn = _step(_octaves(x, y, 0.5 * z, 0.25), 0.1, 0.9)
        return 0.35 * worn, 0.0, fine * (1.0 + 0.12 * (noise(x / 0.012, y / 0.012, z / 0.012) - 0.5))
    if pattern == PRINT:
        return _print(x, y, z, scale)
    if pattern == HAIR:
        strand = noise(x / 0.009, y / 0.009, z / 0.07) - 0.5 + 0.6 * (noise(x / 0.02 + 3.0, y / 0.02, z / 0.12) - 0.5)
        return 0.0, 0.0, 1.0 + 0.75 * strand
    return 0.0, 0.0, fine


@compiled
def _face(x: float, y: float, z: float, marks: np.ndarray) -> tuple[float, float, float]:
    """Shares of blush, lips and brows on skin; marks [4, 3]: nose, left eye, right eye, and (1 / size, 0, 0)."""
    s = marks[3, 0]
    dx, dy, dz = (x - marks[0, 0]) * s, (y - marks[0, 1]) * s, (z - marks[0, 2]) * s
    lips = (1.0 - _step((dy / 0.023) ** 2 + ((dz + 0.042) / 0.0085) ** 2, 1.0, 0.8)) * _step(dx, -0.035, 0.01)
    cheeks = (
        0.5
        * (math.exp(-((abs(dy) - 0.04) ** 2 + (dz + 0.005) ** 2) / 0.0005) + math.exp(-(dy * dy + dz * dz) / 0.00025))
        * _step(dx, -0.07, 0.02)
    )
    brows = 0.0
    for e in (1, 2):
        ey, ez = (y - marks[e, 1]) * s, (z - marks[e, 2]) * s
        brows = max(
            brows,
            (1.0 - _step((ey / 0.021) ** 2 + ((ez - 0.020 + 4.0 * ey * ey) / 0.0042) ** 2, 1.0, 0.7))
            * _step(dx, -0.06, 0.01),
        )
    return cheeks, lips, brows


@compiled
def paint(
    pattern: int,
    colors: np.ndarray,
    scale: float,
    marks: np.ndarray,
    points: np.ndarray,
    tris: np.ndarray,
    uv: np.ndarray,
    index: np.ndarray,
) -> np.ndarray:
    """[n, n, 3] float32 linear albedo of a layer's texture; texels outside every triangle are 0.

    colors [3, 3] linear; points [V, 3] at rest; uv [3 T, 3] places in the texture in texels with depth 1, three a
    triangle; index [n, n] triangle of every texel.
    """
    n = len(index)
    out = np.zeros((n, n, 3), dtype=np.float32)
    corner = np.zeros(3, dtype=np.int64)
    for i in range(n):
        for j in range(n):
            t = index[i, j]
            if t < 0:
                continue
            corner[0], corner[1], corner[2] = 3 * t, 3 * t + 1, 3 * t + 2
            s0, s1, s2 = shares(uv, corner, j + 0.5, i + 0.5)
            a, b, c = points[tris[t, 0]], points[tris[t, 1]], points[tris[t, 2]]
            x, y, z = (
                s0 * a[0] + s1 * b[0] + s2 * c[0],
                s0 * a[1] + s1 * b[1] + s2 * c[1],
                s0 * a[2] + s1 * b[2] + s2 * c[2],
            )
            if pattern == EYE:
                e = 1 if y > marks[0, 1] else 2
                d = math.sqrt((y - marks[e, 1]) ** 2 + (z - marks[e, 2]) ** 2) * marks[3, 0]
                second, third, bright = 1.0 - _step(d, 0.0062, 0.0015), 1.0 - _step(d, 0.0028, 0.0012), 1.0
            else:
                second, third, bright = _weights(pattern, x, y, z, scale)
            if pattern == SKIN:
                blush, second, third = _face(x, y, z, marks)
                bright = 1.0 + 0.6 * (bright - 1.0)
            for k in range(3):
                value = colors[0, k] + second * (colors[1, k] - colors[0, k])
                value = (value + third * (colors[2, k] - value)) * bright
                if pattern == SKIN and k > 0:
                    value *= 1.0 - 0.22 * blush
                out[i, j, k] = min(0.95, max(0.004, value))
    return out


@compiled
def _spread(picture: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill texels outside every triangle from their neighbours, one ring,
    so that filtering at a border mixes nothing foreign."""
    out, filled = picture.copy(), index.copy()
    n = len(index)
    for i in range(n):
        for j in range(n):
            if index[i, j] >= 0:
                continue
            count = 0
            for a in range(max(0, i - 1), min(n, i + 2)):
                for b in range(max(0, j - 1), min(n, j + 2)):
                    if index[a, b] >= 0:
                        count += 1
                        for k in range(3):
                            out[i, j, k] += picture[a, b, k]
            if count:
                filled[i, j] = 0
                for k in range(3):
                    out[i, j, k] /= count
    return out, filled


def texture(
    pattern: int,
    colors: np.ndarray,
    scale: float,
    marks: np.ndarray,
    points: np.ndarray,
    tris: np.ndarray,
    uv: np.ndarray,
    size: int,
) -> np.ndarray:
    """[size, size, 3] float32 linear albedo of one layer. points [V, 3] at rest, tris [T, 3], uv [T, 3, 2] in 0..1."""
    corners = np.ones((3 * len(tris), 3))
    corners[:, 0] = uv[..., 0].reshape(-1) * size
    corners[:, 1] = (1.0 - uv[..., 1].reshape(-1)) * size
    index = rasterize(corners, np.arange(3 * len(tris), dtype=np.int32).reshape(-1, 3), size, size, 1)[1]
    out = paint(pattern, np.asarray(colors, dtype=np.float64), scale, marks, points, tris, corners, index)
    for _ in range(3):
        out, index = _spread(out, index)
    return out
