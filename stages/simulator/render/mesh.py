"""A dressed body at rest as one mesh of layers, and how it follows its bones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.compiling.compiled import compiled


@dataclass(frozen=True, eq=False)
class Texture:
    """One layer's picture and gloss."""

    albedo: np.ndarray
    """[h, w, 3] float32 linear reflectance; row 0 is v = 1, as in OBJ files."""
    gloss: float = 0.0
    """Share of the light that a shiny surface mirrors, seen face-on."""
    exponent: float = 20.0
    """Sharpness of the highlight (Blinn-Phong)."""
    sheen: float = 0.0
    """Share of Fresnel's reflection of sky and ground that a polished surface shows."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles at rest, metres, and what they are made of."""

    vertices: np.ndarray
    """[V, 3] float64."""
    tris: np.ndarray
    """[T, 3] int32."""
    uv: np.ndarray
    """[T, 3, 2] float32 place of each corner in its layer's texture, 0..1."""
    layer: np.ndarray
    """[T] int32 index of the texture."""
    textures: tuple[Texture, ...]
    """Of the layers."""
    bones: np.ndarray
    """[V, 4] int64 bones each vertex follows."""
    weights: np.ndarray
    """[V, 4] float64 how much; sums to 1."""
    slack: np.ndarray
    """[V] metres of loose cloth under the vertex: how far it may lag behind; 0 = skin."""


@compiled
def skin(vertices: np.ndarray, bones: np.ndarray, weights: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """[V, 3] vertices in the world by linear blend skinning: sum_k w_k (R_k x + t_k).
    motion [B, 4, 4] rest to world."""
    out = np.zeros_like(vertices)
    for v in range(len(vertices)):
        for k in range(4):
            w = weights[v, k]
            if w == 0.0:
                continue
            m = motion[bones[v, k]]
            for r in range(3):
                out[v, r] += w * (
                    m[r, 0] * vertices[v, 0] + m[r, 1] * vertices[v, 1] + m[r, 2] * vertices[v, 2] + m[r, 3]
                )
    return out


def joined(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one; layers are numbered on, bones are taken to be the same ones."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    layers = np.cumsum([0, *(len(m.textures) for m in meshes)])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.tris + s for m, s in zip(meshes, starts, strict=False)]).astype(np.int32),
        np.concatenate([m.uv for m in meshes]),
        np.concatenate([m.layer + s for m, s in zip(meshes, layers, strict=False)]).astype(np.int32),
        tuple(t for m in meshes for t in m.textures),
        np.concatenate([m.bones for m in meshes]),
        np.concatenate([m.weights for m in meshes]),
        np.concatenate([m.slack for m in meshes]),
    )


def clipped(inside: np.ndarray, tris: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of some triangles where a field is positive, cut along straight lines.

    inside [V] values of the field at the vertices; tris [T, 3]. Returns tris [N, 3] whose vertices index a list of
    blends; parents [N] the triangle each came from; corners [N, 3, 3] the shares of the parent's corners at each new
    corner.
    """
    f = inside[tris]
    out_corners, out_parent = [], []
    count = (f > 0).sum(axis=1)
    whole = np.nonzero(count == 3)[0]
    out_corners.append(np.broadcast_to(np.eye(3), (len(whole), 3, 3)))
    out_parent.append(whole)
    for n in (1, 2):
        cut = np.nonzero(count == n)[0]
        odd = np.argmax((f[cut] > 0) == (n == 1), axis=1)
        order = (odd[:, None] + np.arange(3)) % 3
        g = np.take_along_axis(f[cut], order, axis=1)
        unit = np.eye(3)[order]  # [C, 3 corners, 3 shares]
        t = (g[:, :1] / (g[:, :1] - g[:, 1:]))[..., None]  # [C, 2, 1] where the two edges from the odd corner are cut
        cuts = unit[:, :1] * (1 - t) + unit[:, 1:] * t
        if n == 1:
            out_corners.append(np.stack([unit[:, 0], cuts[:, 0], cuts[:, 1]], axis=1))
            out_parent.append(cut)
        else:
            out_corners.append(np.stack([cuts[:, 0], unit[:, 1], unit[:, 2]], axis=1))
            out_corners.append(np.stack([cuts[:, 0], unit[:, 2], cuts[:, 1]], axis=1))
            out_parent += [cut, cut]
    parent, corners = np.concatenate(out_parent), np.concatenate(out_corners)
    return parent, corners, tris[parent]
