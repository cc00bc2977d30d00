"""Folds of cloth, as geometry: ridges that run around sleeves and legs, hang down the trunk, and pile up at elbows,
knees and hems."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh
from posegaussian.stages.simulator.render.raster import vertex_normals
from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.shells import noise_at, strongest
from posegaussian.stages.simulator.subjects.skeleton import BONES, SIDES

ROUNDS = 2
"""Times that every triangle becomes four: cloth has edges of 2 cm, folds are as narrow as that."""
ALONG, ACROSS = 0.045, 0.17
"""Cells of the noise across and along a fold's ridge, metres."""
_LIMBS = (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot"))


def quartered(tris: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """[E, 2] edges, whose middles are numbered on after `count` vertices, and [4 T, 3] triangles cut at them."""
    t = tris.astype(np.int64)
    ends = np.sort(np.stack([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]], axis=1).reshape(-1, 2), axis=1)
    edges, back = np.unique(ends, axis=0, return_inverse=True)
    return edges, _four(t, count + back.reshape(-1, 3))


def _four(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """[4 T, 3, ...] of corners [T, 3, ...] and the middles of the edges that start at them."""
    (a, b, c), (d, e, f) = (np.moveaxis(x, 1, 0) for x in (corners, middles))
    parts = np.stack([np.stack(x, axis=1) for x in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))], axis=1)
    return parts.reshape(-1, *corners.shape[1:])


def with_middles(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """[V + E, ...] values of the vertices, then of the middles of edges."""
    return np.concatenate([values, 0.5 * (values[edges[:, 0]] + values[edges[:, 1]])])


def quartered_places(uv: np.ndarray) -> np.ndarray:
    """[4 T, 3, 2] places in the texture of the corners of `quartered` triangles."""
    return _four(uv, 0.5 * (uv + np.roll(uv, -1, axis=1)))


def finer(mesh: Mesh) -> Mesh:
    """The same surface, each triangle as four: cut at the middles of its edges."""
    edges, tris = quartered(mesh.tris, len(mesh.vertices))
    bones, weights = strongest(with_middles(shares_of(mesh), edges))
    return Mesh(
        with_middles(mesh.vertices, edges),
        tris.astype(np.int32),
        quartered_places(mesh.uv).astype(np.float32),
        np.repeat(mesh.layer, 4),
        mesh.textures,
        bones,
        weights,
        with_middles(mesh.slack, edges),
    )


def shares_of(mesh: Mesh) -> np.ndarray:
    """[V, B] share of every bone."""
    out = np.zeros((len(mesh.vertices), len(BONES)))
    np.put_along_axis(out, mesh.bones, mesh.weights, axis=1)
    return out


def ridges(body: Body, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[N] height 0..1 of the folds at points [N, 3] at rest, metres, that follow bones with weights [N, B]."""
    height, limbs = np.zeros(len(points)), np.zeros(len(points))
    for side in SIDES:
        for bone, end in _LIMBS:
            share = weights[:, BONES.index(side + bone)]
            first, last = body.pivot(side + bone), body.pivot(side + end)
            length = np.linalg.norm(last - first)
            axis = (last - first) / length
            t = (points - first) @ axis
            # dense along the limb, so that ridges run around it; they lean by the slow noise
            stretched = points / ACROSS + axis * (t * (1.0 / ALONG - 1.0 / ACROSS))[:, None]
            ends = np.exp(-((t / 0.11) ** 2)) + np.exp(-(((t - length) / 0.11) ** 2))
            height += share * _sharp(points, stretched) * (0.3 + 0.7 * np.minimum(ends, 1.0))
            limbs += share
    hanging = points * np.array([1.0 / ALONG, 1.0 / ALONG, 0.6 / ACROSS])
    waist = body.pivot("left_thigh")[2] + 0.06
    low = np.exp(-(((points[:, 2] - waist) / 0.14) ** 2))
    return height + (1.0 - np.minimum(limbs, 1.0)) * _sharp(points, 0.8 * hanging) * (0.45 + 0.55 * low)


def _sharp(points: np.ndarray, stretched: np.ndarray) -> np.ndarray:
    """[N] 0..1: sharp ridges between round valleys, in the frame of `stretched` [N, 3], bent by slow noise."""
    bend = 1.2 * np.stack([noise_at(points, 0.09, 40.0 + 7.0 * k) for k in range(3)], axis=1)
    n = noise_at(stretched + bend, 1.0, 5.0)
    return (1.0 - np.minimum(np.abs(4.0 * n), 1.0)) ** 1.5


def folded(body: Body, mesh: Mesh, depth: float, free: Callable[[Mesh], np.ndarray]) -> Mesh:
    """A garment with folds that stand out by up to `depth` metres; `free` gives the share 0..1 of that at the vertices
    of a mesh."""
    for _ in range(ROUNDS):
        mesh = finer(mesh)
    out = depth * free(mesh) * ridges(body, mesh.vertices, shares_of(mesh))
    return Mesh(
        mesh.vertices + vertex_normals(mesh.vertices, mesh.tris) * out[:, None],
        mesh.tris,
        mesh.uv,
        mesh.layer,
        mesh.textures,
        mesh.bones,
        mesh.weights,
        mesh.slack,
    )
