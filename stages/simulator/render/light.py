"""Light fixed in the world, and the colour of what a ray meets: textures, diffuse light, highlights, sRGB."""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.mesh import Mesh
from posegaussian.stages.simulator.render.raster import shares

LIGHTS = np.array([[0.62, 0.40, 0.72], [0.30, -0.80, 0.45], [-0.80, 0.15, 0.55]])
LIGHTS /= np.linalg.norm(LIGHTS, axis=1, keepdims=True)
"""[3, 3] unit directions towards key, fill and rim light."""
POWERS = np.array([0.85, 0.42, 0.36])
SKY, GROUND = 0.46, 0.20
"""Light from above and from below, spread over the hemisphere."""


def flat_textures(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All textures as one [N, 3] float32 list; [L, 3] int64 (start, width, height); [L, 3] (gloss, exponent,
    sheen)."""
    pictures = [t.albedo for t in mesh.textures]
    starts = np.cumsum([0, *(p.shape[0] * p.shape[1] for p in pictures)])
    info = np.array([[s, p.shape[1], p.shape[0]] for s, p in zip(starts, pictures, strict=False)], dtype=np.int64)
    return (
        np.concatenate([p.reshape(-1, 3) for p in pictures]),
        info,
        np.array([[t.gloss, t.exponent, t.sheen] for t in mesh.textures]),
    )


@compiled
def _texel(texels: np.ndarray, start: int, width: int, height: int, u: float, v: float, out: np.ndarray) -> None:
    """Bilinear look-up; u to the right, v upwards, 0..1; the border is repeated."""
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    a, b = min(max(int(x0), 0), width - 1), min(max(int(x0) + 1, 0), width - 1)
    c, d = min(max(int(y0), 0), height - 1), min(max(int(y0) + 1, 0), height - 1)
    for k in range(3):
        top = (1.0 - fx) * texels[start + c * width + a, k] + fx * texels[start + c * width + b, k]
        low = (1.0 - fx) * texels[start + d * width + a, k] + fx * texels[start + d * width + b, k]
        out[k] = (1.0 - fy) * top + fy * low


@compiled
def shade(
    index: np.ndarray,
    p: np.ndarray,
    vertices: np.ndarray,
    normals: np.ndarray,
    tris: np.ndarray,
    uv: np.ndarray,
    layer: np.ndarray,
    texels: np.ndarray,
    info: np.ndarray,
    gloss: np.ndarray,
    lit: np.ndarray,
    eye: np.ndarray,
    samples: int,
    shiny: bool,
    lights: np.ndarray,
    powers: np.ndarray,
    sky: float,
    ground: float,
) -> np.ndarray:
    """[h S, w S, 3] float32 linear light of every sample; 0 where there is nothing.

    index from `rasterize`; p [V, 3] picture and depth of the vertices; normals [V, 3] unit, world; lit [V, 1 + n] share
    of the sky and of each light that reaches a vertex; eye [3] the camera's centre. Diffuse light is E = sky ((1 + n_z)
    / 2) + ground ((1 - n_z) / 2) + sum_l power_l max(0, n l). Where `shiny`, a highlight (Blinn-Phong) is added, and on
    polished surfaces what Fresnel mirrors of sky and ground: sheen F (sky (1 + r_z) / 2 + ground (1 - r_z) / 2), F =
    gloss + (1 - gloss) (1 - n v)^5 with the direction v to the camera and the
    mirrored direction r (Schlick's approximation).
    """
    h, w = index.shape
    out = np.zeros((h, w, 3), dtype=np.float32)
    albedo = np.zeros(3)
    for i in range(h):
        for j in range(w):
            t = index[i, j]
            if t < 0:
                continue
            s0, s1, s2 = shares(p, tris[t], (j + 0.5) / samples, (i + 0.5) / samples)
            a, b, c = tris[t, 0], tris[t, 1], tris[t, 2]
            n0 = s0 * normals[a, 0] + s1 * normals[b, 0] + s2 * normals[c, 0]
            n1 = s0 * normals[a, 1] + s1 * normals[b, 1] + s2 * normals[c, 1]
            n2 = s0 * normals[a, 2] + s1 * normals[b, 2] + s2 * normals[c, 2]
            x0 = eye[0] - (s0 * vertices[a, 0] + s1 * vertices[b, 0] + s2 * vertices[c, 0])
            x1 = eye[1] - (s0 * vertices[a, 1] + s1 * vertices[b, 1] + s2 * vertices[c, 1])
            x2 = eye[2] - (s0 * vertices[a, 2] + s1 * vertices[b, 2] + s2 * vertices[c, 2])
            length = max(1e-12, math.sqrt(n0 * n0 + n1 * n1 + n2 * n2))
            # inside a sleeve or a collar the cloth's other side is seen
            f0 = (vertices[b, 1] - vertices[a, 1]) * (vertices[c, 2] - vertices[a, 2]) - (
                vertices[b, 2] - vertices[a, 2]
            ) * (vertices[c, 1] - vertices[a, 1])
            f1 = (vertices[b, 2] - vertices[a, 2]) * (vertices[c, 0] - vertices[a, 0]) - (
                vertices[b, 0] - vertices[a, 0]
            ) * (vertices[c, 2] - vertices[a, 2])
            f2 = (vertices[b, 0] - vertices[a, 0]) * (vertices[c, 1] - vertices[a, 1]) - (
                vertices[b, 1] - vertices[a, 1]
            ) * (vertices[c, 0] - vertices[a, 0])
            if f0 * x0 + f1 * x1 + f2 * x2 < 0.0:
                length = -length
            n0, n1, n2 = n0 / length, n1 / length, n2 / length
            k = layer[t]
            _texel(
                texels,
                info[k, 0],
                info[k, 1],
                info[k, 2],
                s0 * uv[t, 0, 0] + s1 * uv[t, 1, 0] + s2 * uv[t, 2, 0],
                s0 * uv[t, 0, 1] + s1 * uv[t, 1, 1] + s2 * uv[t, 2, 1],
                albedo,
            )
            light = (s0 * lit[a, 0] + s1 * lit[b, 0] + s2 * lit[c, 0]) * (
                sky * 0.5 * (1.0 + n2) + ground * 0.5 * (1.0 - n2)
            )
            mirrored = 0.0
            if shiny and gloss[k, 2] > 0.0:
                d = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
                facing = max(0.0, (n0 * x0 + n1 * x1 + n2 * x2) / d)
                fresnel = gloss[k, 2] * (gloss[k, 0] + (1.0 - gloss[k, 0]) * (1.0 - facing) ** 5)
                r2 = 2.0 * facing * n2 - x2 / d
                mirrored = (
                    fresnel
                    * (s0 * lit[a, 0] + s1 * lit[b, 0] + s2 * lit[c, 0])
                    * (sky * 0.5 * (1.0 + r2) + ground * 0.5 * (1.0 - r2))
                )
            for m in range(len(lights)):
                facing = n0 * lights[m, 0] + n1 * lights[m, 1] + n2 * lights[m, 2]
                if facing <= 0.0:
                    continue
                power = powers[m] * (s0 * lit[a, 1 + m] + s1 * lit[b, 1 + m] + s2 * lit[c, 1 + m])
                light += power * facing
                if shiny:
                    d = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
                    h0, h1, h2 = x0 / d + lights[m, 0], x1 / d + lights[m, 1], x2 / d + lights[m, 2]
                    half = max(0.0, n0 * h0 + n1 * h1 + n2 * h2) / math.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
                    mirrored += power * gloss[k, 0] * (gloss[k, 1] + 8.0) / 8.0 * half ** gloss[k, 1]
            for r in range(3):
                out[i, j, r] = light * albedo[r] + mirrored
    return out


_FINE = np.linspace(0.0, 1.0, 8193)
SRGB = np.where(_FINE <= 0.0031308, 12.92 * _FINE, 1.055 * np.power(_FINE, 1 / 2.4) - 0.055)
"""sRGB of 8193 evenly spaced amounts of light; read between them linearly it is off by less than 1e-5."""


@compiled
def averaged(
    light: np.ndarray, index: np.ndarray, own: int, samples: int, table: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples to pixels: [h, w, 3] float32 sRGB 0..1 premultiplied, [h, w] share covered by anything, and by the first
    `own` triangles.

    light [h S, w S, 3] linear; index [h S, w S] from `rasterize`. Each sample is encoded first: the project blends in
    sRGB.
    """
    h, w = index.shape[0] // samples, index.shape[1] // samples
    color = np.zeros((h, w, 3), dtype=np.float32)
    cover, mine = np.zeros((h, w)), np.zeros((h, w))
    n = len(table) - 1
    for i in range(h):
        for j in range(w):
            r, g, b, any_, of_own = 0.0, 0.0, 0.0, 0, 0
            for y in range(i * samples, (i + 1) * samples):
                for x in range(j * samples, (j + 1) * samples):
                    t = index[y, x]
                    if t < 0:
                        continue
                    any_ += 1
                    of_own += t < own
                    for k in range(3):
                        at = min(max(light[y, x, k], 0.0), 1.0) * n
                        low = min(int(at), n - 1)
                        value = table[low] + (at - low) * (table[low + 1] - table[low])
                        if k == 0:
                            r += value
                        elif k == 1:
                            g += value
                        else:
                            b += value
            if any_:
                count = samples * samples
                color[i, j, 0], color[i, j, 1], color[i, j, 2] = r / count, g / count, b / count
                cover[i, j], mine[i, j] = any_ / count, of_own / count
    return color, cover, mine


def encode(linear: np.ndarray) -> np.ndarray:
    """SRGB 0..1 of linear light (IEC 61966-2-1), clipped to 0..1; float32."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055).astype(np.float32)


def decode(srgb: np.ndarray) -> np.ndarray:
    """Linear light of sRGB 0..1; float32."""
    return np.where(srgb <= 0.04045, srgb / 12.92, np.power((np.asarray(srgb) + 0.055) / 1.055, 2.4)).astype(np.float32)
