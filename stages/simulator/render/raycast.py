"""First hits of rays on ellipsoids and round cones, in closed form.

A primitive lives in the rest frame of its bone; rays are carried there by a rigid motion, which leaves the ray
parameter as it is. Rays have camera direction (x, y, 1), so the parameter *is* the depth along the optical axis.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled

ELLIPSOID = 0
"""Geometry: centre (3), semi-axes along the rest frame's axes (3)."""
ROUND_CONE = 1
"""Geometry: centre a (3), centre b (3), radius at a, radius at b: the convex hull of two balls."""
NO_HIT = np.inf


@compiled
def ellipsoid_hit(o: np.ndarray, d: np.ndarray, g: np.ndarray) -> float:
    """Parameter at which the ray o + t d enters an ellipsoid, or inf; the quadratic of the scaled unit ball."""
    dd = od = oo = 0.0
    for k in range(3):
        p, q = (o[k] - g[k]) / g[3 + k], d[k] / g[3 + k]
        dd += q * q
        od += p * q
        oo += p * p
    h = od * od - dd * (oo - 1.0)
    if h < 0.0:
        return np.inf
    t = (-od - math.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@compiled
def _ball_entry(dd: float, od: float, oo: float, radius: float) -> float:
    h = od * od - dd * (oo - radius * radius)
    if h < 0.0:
        return np.inf
    t = (-od - math.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@compiled
def round_cone_hit(o: np.ndarray, d: np.ndarray, g: np.ndarray) -> float:
    """Parameter at which the ray o + t d enters a round cone, or inf.

    With axis w, length L, s = (ra - rb) / L and c² = 1 - s², the lateral surface is c² |q|² = y² - 2 s ra y + ra² for
    q = p - a and y = q·w in [ra s, L + rb s]. Its two end discs lie inside the balls, so the first entry of the union
    is the smallest entry of the three pieces.
    """
    wx, wy, wz = g[3] - g[0], g[4] - g[1], g[5] - g[2]
    length = math.sqrt(wx * wx + wy * wy + wz * wz)
    wx, wy, wz = wx / length, wy / length, wz / length
    qx, qy, qz = o[0] - g[0], o[1] - g[1], o[2] - g[2]
    ra, rb = g[6], g[7]
    dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    od = qx * d[0] + qy * d[1] + qz * d[2]
    oo = qx * qx + qy * qy + qz * qz
    y0, dy = qx * wx + qy * wy + qz * wz, d[0] * wx + d[1] * wy + d[2] * wz
    best = min(
        _ball_entry(dd, od, oo, ra), _ball_entry(dd, od - length * dy, oo - 2.0 * length * y0 + length * length, rb)
    )
    s = (ra - rb) / length
    c2 = 1.0 - s * s
    a = c2 * dd - dy * dy
    b = c2 * od - y0 * dy + s * ra * dy
    c = c2 * oo - y0 * y0 + 2.0 * s * ra * y0 - ra * ra
    h = b * b - a * c
    if h >= 0.0:
        root = math.sqrt(h)
        # The entering root, in the form that does not cancel and that survives a = 0.
        if b < 0.0:
            t = c / (root - b)
        elif a != 0.0:
            t = (-b - root) / a
        else:
            return best
        y = y0 + t * dy
        if 0.0 < t < best and ra * s <= y <= length + rb * s:
            return t
    return best


@compiled
def normal_at(kind: int, p: np.ndarray, g: np.ndarray, out: np.ndarray) -> None:
    """Outward unit normal [3] of a primitive at a surface point p, in the rest frame, written to `out`."""
    if kind == ELLIPSOID:
        for k in range(3):
            out[k] = (p[k] - g[k]) / (g[3 + k] * g[3 + k])
    else:
        w = g[3:6] - g[0:3]
        length = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        s = (g[6] - g[7]) / length
        y = ((p[0] - g[0]) * w[0] + (p[1] - g[1]) * w[1] + (p[2] - g[2]) * w[2]) / length
        along = min(max((y - g[6] * s) / (1.0 - s * s) / length, 0.0), 1.0)
        for k in range(3):
            out[k] = p[k] - g[k] - along * w[k]
    norm = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    for k in range(3):
        out[k] /= norm


@compiled
def _grow(box: np.ndarray, centre: np.ndarray, ex: float, ey: float, ez: float) -> None:
    near, far = centre[2] - ez, centre[2] + ez
    if near <= 1e-6:
        box[0], box[1], box[2], box[3] = -np.inf, -np.inf, np.inf, np.inf
        return
    for axis in range(2):
        e = ex if axis == 0 else ey
        low, high = centre[axis] - e, centre[axis] + e
        box[axis] = min(box[axis], low / near, low / far)
        box[2 + axis] = max(box[2 + axis], high / near, high / far)


@compiled
def _carried(rotation: np.ndarray, point: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """R x + t by hand: numba's own matrix product wants SciPy."""
    out = shift.copy()
    for k in range(3):
        for j in range(3):
            out[k] += rotation[k, j] * point[j]
    return out


@compiled
def bounds(kind: int, g: np.ndarray, to_camera: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """[4] (x0, y0, x1, y1) in normalised picture coordinates that hold the whole primitive; infinite when it is not in
    front.

    `to_camera` [3, 3] and `shift` [3] carry rest coordinates to camera coordinates.
    """
    box = np.array([np.inf, np.inf, -np.inf, -np.inf])
    if kind == ELLIPSOID:
        e = np.zeros(3)
        for k in range(3):
            for j in range(3):
                e[k] += (to_camera[k, j] * g[3 + j]) ** 2
        _grow(box, _carried(to_camera, g[0:3], shift), math.sqrt(e[0]), math.sqrt(e[1]), math.sqrt(e[2]))
    else:
        _grow(box, _carried(to_camera, g[0:3], shift), g[6], g[6], g[6])
        _grow(box, _carried(to_camera, g[3:6], shift), g[7], g[7], g[7])
    return box


@compiled
def _samples(low: float, high: float, focal: float, principal: float, sub: int, length: int) -> tuple[int, int]:
    first, last = (focal * low + principal) * sub - 1.5, (focal * high + principal) * sub + 0.5
    return int(max(0.0, min(first, float(length)))), int(max(0.0, min(last + 1.0, float(length))))


@compiled
def cast(
    kinds: np.ndarray,
    geometry: np.ndarray,
    rotation: np.ndarray,
    shift: np.ndarray,
    k: np.ndarray,
    size: tuple[int, int],
    sub: int,
) -> tuple[np.ndarray, np.ndarray]:
    """First hits of one camera: depth [h·sub, w·sub] float64 in metres (inf: none) and primitive [h·sub, w·sub] int16
    (-1: none).

    kinds [P], geometry [P, 8]; rotation [P, 3, 3] and shift [P, 3] carry rest coordinates of each primitive to camera
    coordinates; k [3, 3] intrinsics in our pixel centres without skew; size (width, height). Sample (i, j) of a picture
    with `sub` samples a side looks through ((j + 0.5) / sub, (i + 0.5) / sub): sub = 1 is the pixel centre.
    """
    width, height = size[0] * sub, size[1] * sub
    depth = np.full((height, width), np.inf)
    hit = np.full((height, width), np.int16(-1))
    o, d = np.empty(3), np.empty(3)
    for p in range(kinds.shape[0]):
        r = rotation[p]
        box = bounds(kinds[p], geometry[p], r, shift[p])
        x0, x1 = _samples(box[0], box[2], k[0, 0], k[0, 2], sub, width)
        y0, y1 = _samples(box[1], box[3], k[1, 1], k[1, 2], sub, height)
        for c in range(3):
            o[c] = -(r[0, c] * shift[p, 0] + r[1, c] * shift[p, 1] + r[2, c] * shift[p, 2])
        for i in range(y0, y1):
            y = ((i + 0.5) / sub - k[1, 2]) / k[1, 1]
            for j in range(x0, x1):
                x = ((j + 0.5) / sub - k[0, 2]) / k[0, 0]
                for c in range(3):
                    d[c] = r[0, c] * x + r[1, c] * y + r[2, c]
                t = ellipsoid_hit(o, d, geometry[p]) if kinds[p] == ELLIPSOID else round_cone_hit(o, d, geometry[p])
                if t < depth[i, j]:
                    depth[i, j] = t
                    hit[i, j] = p
    return depth, hit
