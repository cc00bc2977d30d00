"""A relief: what a single silhouette says of a body's shape, at a distance that is assumed.

The outline lies at the subject's distance, and inside it the surface bulges towards the camera by sqrt(u), u the
solution of

    laplace(u) - u / l^2 = -2,  u = 0 on the outline.

A limb narrower than l comes out as a round cylinder (u = r^2 - x^2), a torso many times as wide no thicker than sqrt(2)
l: bodies are flatter than they are wide. l follows from the area of the silhouette, so that the shape depends on
neither resolution nor distance. Limbs in front of the body leave no outline and are flat; nothing is known of the side
that faces away.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.storage.model.masks import foreground

THICKNESS = 0.11
"""l over the square root of the silhouette's area: 8 cm of a standing person, who shows half a square metre."""
GUESSED = 0.45
"""Confidence of a relief: less than that of any match, but no other view fills in behind it, so what is see-through
would only be dark."""


def relief(mask: np.ndarray, distance: float, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth [h, w] m and confidence [h, w], float32, of one picture with mask [h, w] uint8; 0 outside the silhouette.

    Args:
        mask: 0..255 foreground.
        distance: of the outline along the optical axis, m.
        focal: focal length, px.

    A silhouette that is cut off by the picture's edge is not rounded there. One that fills the picture is a plane.
    """
    inside = foreground(mask)
    depth, confidence = np.zeros(mask.shape, np.float32), np.where(inside, np.float32(GUESSED), np.float32(0))
    if not inside.any():
        return depth, confidence
    if inside.all():
        depth[:] = distance
        return depth, confidence
    width = THICKNESS * math.sqrt(int(inside.sum()))
    rows, columns = np.nonzero(inside)
    window = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    bulge = np.zeros(mask.shape)
    bulge[window] = np.sqrt(_solve(np.pad(inside[window], 1), _open_sides(inside, window), max(width, 1.0)))[1:-1, 1:-1]
    # No part of the subject is nearer than half the distance, whatever its size in the picture.
    depth[inside] = distance * np.maximum(1 - bulge[inside] / focal, 0.5)
    return depth, confidence


def _open_sides(inside: np.ndarray, window: tuple[slice, slice]) -> np.ndarray:
    """[4] bool: whether the window touches the picture's upper, lower, left and right edge, where the body goes on
    unseen."""
    rows, columns = window
    return np.array(
        [rows.start == 0, rows.stop == inside.shape[0], columns.start == 0, columns.stop == inside.shape[1]]
    )


def _solve(inside: np.ndarray, unseen: np.ndarray, width: float) -> np.ndarray:
    """[h, w] float64 u in px^2, of `inside` [h, w] bool with a rim of background; `width` is l in px.

    Where a side of the rim is `unseen` [4], the gradient across it is 0 instead of u.
    """
    around = np.full(inside.shape, 4.0)
    edges: tuple[Any, ...] = (np.s_[1], np.s_[-2], np.s_[:, 1], np.s_[:, -2])
    for side, edge in zip(unseen, edges, strict=True):
        around[edge] -= side
    u = np.zeros(inside.shape)
    at = np.flatnonzero(inside)
    _relax(
        u.reshape(-1),
        at,
        1 / (around.reshape(-1)[at] + 1 / width**2),
        inside.shape[1],
        2 / (1 + math.sqrt(0.5) / width),
        int(4 * width) + 20,
    )
    return np.maximum(u, 0.0)


@compiled
def _relax(u: np.ndarray, at: np.ndarray, share: np.ndarray, row: int, relaxation: float, sweeps: int) -> None:
    """Successive over-relaxation of u [n] at the pixels `at` [m]; a pixel is its neighbours' sum and the bulge's 2,
    times its `share` [m].

    With the best `relaxation`, 2 / (1 + sqrt(1/2) / l), an error shrinks by a factor of e in l / 2.8 sweeps.
    """
    for _ in range(sweeps):
        for k in range(len(at)):
            i = at[k]
            u[i] += relaxation * ((u[i - row] + u[i + row] + u[i - 1] + u[i + 1] + 2.0) * share[k] - u[i])
