"""Loose hair: thin strands that leave the hair's shell in tufts and bend downwards; a pixel sees several of them, and
what is behind."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, Texture
from posegaussian.stages.simulator.wardrobe.description import Hair

PIECES = 4
"""Straight pieces of a strand."""
_SHADES = np.linspace(0.55, 1.5, 8, dtype=np.float32)
"""Brightness of strands relative to the hair's colour."""


def strands(shell: Mesh, hair: Hair, color: np.ndarray) -> Mesh:
    """Strands rooted all over a hair's shell, that move as their roots do.

    color [3] linear reflectance. Tufts start evenly over the area; each strand is a ribbon that ends in a point, with a
    width of its own direction, so that from any side some are broad and some narrow.
    """
    random = np.random.default_rng(1)
    corners = shell.vertices[shell.tris]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / np.maximum(area, 1e-12)[:, None]
    tufts = -(-hair.strands // hair.tuft)
    root = np.repeat(np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(tufts) + 0.5) / tufts), hair.tuft)
    root = root[: hair.strands]
    n = len(root)
    tuft = np.arange(n) // hair.tuft
    places = random.dirichlet((1.0, 1.0, 1.0), n)
    start = np.einsum("nk,nkd->nd", places, corners[root])
    # a tuft leans as one, its strands a little apart; down, and away from the face
    lean = random.normal(size=(tufts, 3))[tuft] + 0.35 * random.normal(size=(n, 3))
    lying = np.array([-0.25, 0.0, -1.0]) - out[root] * (out[root] @ np.array([-0.25, 0.0, -1.0]))[:, None]
    ahead = hair.loose * out[root] + (1.0 - 0.6 * hair.loose) * lying + 0.35 * lean
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    length = hair.length * (0.45 + 0.55 * random.random(tufts)[tuft]) * (0.8 + 0.4 * random.random(n))
    t = np.linspace(0.0, 1.0, PIECES + 1)
    fall = np.array([-0.1, 0.0, -0.55]) * length[:, None]
    line = (
        start[:, None] + t[None, :, None] * (ahead * length[:, None])[:, None] + (t**2)[None, :, None] * fall[:, None]
    )
    across = np.cross(ahead, random.normal(size=(n, 3)))
    across *= (0.5 * hair.width / np.maximum(np.linalg.norm(across, axis=1), 1e-9))[:, None]
    wide = across[:, None] * (1.0 - t[:-1])[None, :, None]
    # two points at every joint but the last: [n, 2 PIECES + 1]
    points = np.concatenate(
        [np.stack([line[:, :-1] - wide, line[:, :-1] + wide], axis=2).reshape(n, -1, 3), line[:, -1:]], axis=1
    )
    k = 2 * np.arange(PIECES)
    piece = [np.stack([k, k + 1, k + 2], axis=1), np.stack([k + 1, k + 3, k + 2], axis=1)[:-1]]
    tris = (np.concatenate(piece)[None] + (2 * PIECES + 1) * np.arange(n)[:, None, None]).reshape(-1, 3)
    shade = (random.integers(len(_SHADES), size=n) + 0.5) / len(_SHADES)
    uv = np.full((n, len(tris) // n, 3, 2), 0.5, np.float32)
    uv[..., 0] = shade[:, None, None]
    # a strand is rigid and follows what carries its root most
    carrier = shell.tris[root, places.argmax(axis=1)]
    return Mesh(
        points.reshape(-1, 3),
        tris.astype(np.int32),
        uv.reshape(-1, 3, 2),
        np.zeros(len(tris), np.int32),
        (Texture((_SHADES[None, :, None] * color).astype(np.float32), 0.05, 25.0),),
        np.repeat(shell.bones[carrier], 2 * PIECES + 1, axis=0),
        np.repeat(shell.weights[carrier], 2 * PIECES + 1, axis=0),
        np.zeros(n * (2 * PIECES + 1)),
    )
