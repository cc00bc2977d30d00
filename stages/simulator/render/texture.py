"""What the person looks like: colour as a function of a point of the body at rest, and light fixed in the world."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.raycast import normal_at

SKIN, HAIR, SHIRT, TROUSERS, SHOES = range(5)

CELLS = np.array([0.011, 0.024, 0.052, 0.11])
"""Cell sizes of the noise's octaves, metres: from three pixels of a 512 px picture to three pixels of a 48 px one."""
WEIGHTS = np.array([0.36, 0.27, 0.20, 0.17])
BASE = np.array([[0.86, 0.65, 0.53], [0.30, 0.19, 0.11], [0.24, 0.46, 0.78], [0.50, 0.47, 0.37], [0.62, 0.20, 0.14]])
"""[material, rgb] sRGB."""
CONTRAST = np.array([0.55, 0.95, 0.95, 0.95, 0.80])
"""[material] peak to peak of the noise relative to the base colour."""
LIGHTS = np.array([[0.55, -0.35, 0.76], [-0.60, 0.62, 0.50], [0.0, 0.0, 1.0]])
LIGHTS /= np.linalg.norm(LIGHTS, axis=1, keepdims=True)
"""[light, 3] unit directions towards the lights, world."""
POWERS = np.array([0.45, 0.30, 0.12])
AMBIENT = 0.45
EYES = np.array([[0.097, 0.034, 1.635], [0.097, -0.034, 1.635]])
"""[2, 3] left and right eye at rest, metres; the COCO joints of the same name."""
MOUTH_HEIGHT = 1.565


@compiled
def _hash(x: int, y: int, z: int) -> float:
    """Uniform [0, 1) from lattice coordinates: a 32 bit integer mix, equal on every machine."""
    h = (x * 374761393 + y * 668265263 + z * 2147483647 + 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFFFF) / 16777216.0


@compiled
def noise(x: float, y: float, z: float) -> float:
    """Smooth value noise in [0, 1] with unit cells: lattice values blended by 3t² - 2t³."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    a, b, c = int(i), int(j), int(k)
    total = 0.0
    for dz in range(2):
        for dy in range(2):
            weight = (v if dy else 1 - v) * (w if dz else 1 - w)
            total += weight * ((1 - u) * _hash(a, b + dy, c + dz) + u * _hash(a + 1, b + dy, c + dz))
    return total


@compiled
def fabric(p: np.ndarray, material: int) -> float:
    """Octaves of noise at a rest point, [-1, 1] around 0; each material has its own pattern."""
    value = 0.0
    for n in range(CELLS.shape[0]):
        shift = 17.3 * n + 5.1 * material
        value += WEIGHTS[n] * (
            noise(p[0] / CELLS[n] + shift, p[1] / CELLS[n] - shift, p[2] / CELLS[n] + 0.5 * shift) - 0.5
        )
    # The sum of octaves rarely leaves the middle third of its range; spread it, and clip what is left.
    return min(max(5.0 * value, -1.0), 1.0)


@compiled
def _step(edge: float, width: float, x: float) -> float:
    t = min(max((x - edge) / width + 0.5, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@compiled
def albedo(p: np.ndarray, material: int, out: np.ndarray) -> None:
    """Colour [3] in 0..1 (sRGB) of a point of the body at rest, written to `out`."""
    value = fabric(p, material)
    for c in range(3):
        out[c] = BASE[material, c] * (1.0 + 0.5 * CONTRAST[material] * value)
    if material == SHIRT:
        # A light band every 14 cm.
        wave = math.sin(p[2] * (2.0 * math.pi / 0.14))
        band = _step(0.35, 0.35, wave)
        for c in range(3):
            out[c] += band * (0.88 - 0.06 * c - out[c]) * (0.78 + 0.22 * value)
    elif material == SKIN and p[2] > 1.5 and p[0] > 0.03:
        _face(p, out)
    for c in range(3):
        out[c] = min(max(out[c], 0.02), 1.0)


@compiled
def _face(p: np.ndarray, out: np.ndarray) -> None:
    for n in range(2):
        dy, dz = p[1] - EYES[n, 1], p[2] - EYES[n, 2]
        white = 1.0 - _step(0.016, 0.004, math.sqrt(dy * dy + 2.2 * dz * dz))
        iris = 1.0 - _step(0.008, 0.003, math.sqrt(dy * dy + dz * dz))
        brow = (1.0 - _step(0.021, 0.006, abs(dy))) * (1.0 - _step(0.005, 0.004, abs(dz - 0.026)))
        for c in range(3):
            out[c] += white * (0.92 - out[c])
            out[c] += iris * (0.08 + 0.04 * c - out[c])
            out[c] += brow * (BASE[HAIR, c] - out[c])
    lips = (1.0 - _step(0.026, 0.006, abs(p[1]))) * (1.0 - _step(0.006, 0.004, abs(p[2] - MOUTH_HEIGHT)))
    out[0] += lips * (0.62 - out[0])
    out[1] += lips * (0.24 - out[1])
    out[2] += lips * (0.24 - out[2])


@compiled
def light(n: np.ndarray) -> float:
    """Lambert shading of a unit world normal [3] under fixed lights, 0..1: the same from every camera."""
    total = AMBIENT
    for i in range(LIGHTS.shape[0]):
        total += POWERS[i] * max(n[0] * LIGHTS[i, 0] + n[1] * LIGHTS[i, 1] + n[2] * LIGHTS[i, 2], 0.0)
    return min(total, 1.0)


@compiled
def shade(
    depth: np.ndarray,
    hit: np.ndarray,
    kinds: np.ndarray,
    geometry: np.ndarray,
    materials: np.ndarray,
    to_world: np.ndarray,
    rotation: np.ndarray,
    shift: np.ndarray,
    k: np.ndarray,
    sub: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Box-filtered colour [h, w, 3] and coverage [h, w], float64 in 0..1, from the samples of `raycast.cast`.

    to_world [P, 3, 3] turns rest normals of each primitive into world normals; the rest as in `cast`. Colour is
    premultiplied by coverage: samples without a hit count as black.
    """
    height, width = hit.shape[0] // sub, hit.shape[1] // sub
    color, cover = np.zeros((height, width, 3)), np.zeros((height, width))
    p, n, w, rgb = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    q = np.empty(3)
    share = 1.0 / (sub * sub)
    for i in range(hit.shape[0]):
        y = ((i + 0.5) / sub - k[1, 2]) / k[1, 1]
        for j in range(hit.shape[1]):
            part = hit[i, j]
            if part < 0:
                continue
            t, r = depth[i, j], rotation[part]
            q[0] = t * ((j + 0.5) / sub - k[0, 2]) / k[0, 0] - shift[part, 0]
            q[1], q[2] = t * y - shift[part, 1], t - shift[part, 2]
            for c in range(3):
                p[c] = r[0, c] * q[0] + r[1, c] * q[1] + r[2, c] * q[2]
            normal_at(kinds[part], p, geometry[part], n)
            for c in range(3):
                w[c] = to_world[part, c, 0] * n[0] + to_world[part, c, 1] * n[1] + to_world[part, c, 2] * n[2]
            albedo(p, materials[part], rgb)
            bright = share * light(w)
            for c in range(3):
                color[i // sub, j // sub, c] += bright * rgb[c]
            cover[i // sub, j // sub] += share
    return color, cover
