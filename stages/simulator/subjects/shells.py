"""Shells over the skin: the body's own surface smoothed, pushed out, cut along a field, and painted.

A shell is the skin's own surface, smoothed until it no longer follows every muscle, pushed out along its normals, never
closer to the skin than a few millimetres. A field that is positive inside says how far it reaches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.simulator.render.mesh import Mesh, Texture, clipped
from posegaussian.stages.simulator.render.patterns import PATTERNS, texture
from posegaussian.stages.simulator.render.raster import vertex_normals
from posegaussian.stages.simulator.render.texture import noise
from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.outfits import Rgb

TEXELS = 1024
"""Side of a layer's texture: about 2 mm a texel on the body."""
BLANK = Texture(np.zeros((1, 1, 3), np.float32))
"""Of what is painted later."""


@dataclass(frozen=True, eq=False)
class Shell:
    """A surface over the whole body, and how far it reaches."""

    vertices: np.ndarray
    """[V, 3] one a vertex of the body, metres."""
    inside: np.ndarray
    """[V] metres inside its hems; negative outside."""
    slack: np.ndarray
    """[V] metres of loose cloth."""


def smoothed(values: np.ndarray, edges: np.ndarray, weight: np.ndarray, rounds: int) -> np.ndarray:
    """Laplacian smoothing over the vertices with weight > 0;
    each moves by `weight` of the way to its neighbours' mean."""
    own = edges[(weight[edges] > 0).all(axis=1)]
    a, b = np.concatenate([own[:, 0], own[:, 1]]), np.concatenate([own[:, 1], own[:, 0]])
    count = np.maximum(np.bincount(a, minlength=len(values)), 1)[:, None]
    linked = np.bincount(a, minlength=len(values)) > 0
    out = values.copy()
    for _ in range(rounds):
        mean = np.stack([np.bincount(a, out[b, k], minlength=len(values)) for k in range(3)], axis=1) / count
        out = np.where(linked[:, None], out + weight[:, None] * (mean - out), out)
    return out


def noise_at(points: np.ndarray, cell: float, shift: float) -> np.ndarray:
    """[N] smooth noise in -0.5..0.5 at points [N, 3], metres, with cells of `cell` metres."""
    return _noises(points / cell, shift) - 0.5


@compiled
def _noises(points: np.ndarray, shift: float) -> np.ndarray:
    out = np.empty(len(points))
    for n in range(len(points)):
        out[n] = noise(points[n, 0] + shift, points[n, 1], points[n, 2])
    return out


def shell(
    body: Body, inside: np.ndarray, offset: np.ndarray, rounds: int, wrinkles: float, follows: np.ndarray | float = 1.0
) -> np.ndarray:
    """[V, 3] the skin smoothed and pushed out by `offset` metres, where it `follows` (0..1) nowhere nearer than a
    third of it."""
    region = (inside > -0.06).astype(np.float64)
    smooth = smoothed(body.vertices, body.edges, 0.5 * region, rounds)
    used = body.tris[(inside[body.tris] > -0.08).any(axis=1)]
    out_of_skin, out = vertex_normals(body.vertices, body.tris), vertex_normals(smooth, used)
    if wrinkles:
        p = body.vertices * np.array([1.0, 1.0, 1.6])
        offset = offset + wrinkles * (np.abs(noise_at(p, 0.075, 0.0)) * -2.0 + 0.5 + noise_at(p, 0.03, 11.0))
    pushed = smooth + out * offset[:, None]
    short = np.maximum(0.35 * offset, 0.004) - np.einsum("vk,vk->v", pushed - body.vertices, out_of_skin)
    pushed += out_of_skin * (follows * np.maximum(short, 0.0))[:, None]
    return smoothed(pushed, body.edges, 0.35 * region, 2)


def cut(body: Body, whole: Shell, layer: Texture = BLANK) -> Mesh:
    """The part of a shell where the field is positive, as a mesh of its own."""
    parent, corners, tris = clipped(whole.inside, body.tris)
    flat = corners.reshape(-1, 3)
    owners = np.repeat(tris, 3, axis=0)
    ranked = np.where(flat > 0, owners, -1)
    low_rank = np.argsort(ranked, axis=1, kind="stable")
    ids = np.take_along_axis(ranked, low_rank, axis=1)[:, 1:]
    part = np.take_along_axis(flat, low_rank, axis=1)[:, 1:]
    single = ids[:, 0] < 0
    ids[single, 0], part[single, 0] = ids[single, 1], 0.0
    _, first, back = np.unique(
        ids[:, 0] * (len(whole.vertices) + 1) + ids[:, 1], return_index=True, return_inverse=True
    )
    a, b, s, t = ids[first, 0], ids[first, 1], part[first, :1], part[first, 1:]

    def blend(values: np.ndarray) -> np.ndarray:
        return s * values[a] + t * values[b]

    uv = np.einsum("nij,njk->nik", corners, body.uv[parent]).astype(np.float32)
    bones, weights = strongest(blend(body.weights))
    return Mesh(
        blend(whole.vertices),
        back.reshape(-1, 3).astype(np.int32),
        uv,
        np.zeros(len(parent), np.int32),
        (layer,),
        bones,
        weights,
        blend(whole.slack[:, None])[:, 0],
    )


def strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[V, 4] bones and [V, 4] weights from [V, B]."""
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    best = np.take_along_axis(weights, index, axis=1)
    return index, best / best.sum(axis=1, keepdims=True)


def linear(color: Rgb | tuple[float, float, float]) -> np.ndarray:
    """[3] linear reflectance of an sRGB colour in bytes (IEC 61966-2-1)."""
    c = np.array(color, dtype=np.float64) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def marks(body: Body) -> np.ndarray:
    """[4, 3] nose, eyes, and 1 / size of the head relative to an adult's, whose eyes are 64 mm apart."""
    apart = np.linalg.norm(body.joints[1] - body.joints[2])
    return np.stack([*body.joints[:3], [0.064 / apart, 0.0, 0.0]])


def painted(
    body: Body,
    mesh: Mesh,
    pattern: str,
    colors: tuple[Rgb, Rgb, Rgb],
    scale: float,
    gloss: float,
    exponent: float = 20.0,
    texels: int = TEXELS,
    sheen: float = 0.0,
) -> Mesh:
    """A mesh of one layer with a pattern on it: three sRGB colours in bytes, the period in metres, how it mirrors."""
    picture = texture(
        PATTERNS.index(pattern),
        np.stack([linear(c) for c in colors]),
        scale,
        marks(body),
        mesh.vertices,
        mesh.tris,
        mesh.uv,
        texels,
    )
    return Mesh(
        mesh.vertices,
        mesh.tris,
        mesh.uv,
        mesh.layer,
        (Texture(picture, gloss, exponent, sheen),),
        mesh.bones,
        mesh.weights,
        mesh.slack,
    )
