"""Joints as heatmaps: one Gaussian peak a joint on a grid of 4 x 4 pixel cells."""

from __future__ import annotations

import numpy as np

CELL = 4
"""Edge of a heatmap cell, px of frames/*."""
FLOOR = 1e-3
"""Values below are 0: what compresses well and what nobody needs."""
MIN_SIGMA = CELL / 2
"""Pixels; a narrower peak would fall between the cell centres and vanish, so it is drawn this wide."""


def grid_of(sizes: np.ndarray) -> tuple[int, int]:
    """(rows, columns) of the heatmaps of views with sizes [V, 2] (width, height):
    those of the largest, as frames/* is padded."""
    width, height = (int(n) for n in sizes.max(axis=0))
    return -(-height // CELL), -(-width // CELL)


def draw(joints: np.ndarray, sigma: np.ndarray, size: tuple[int, int], grid: tuple[int, int]) -> np.ndarray:
    """Joints [F, J, 3] (u, v, score) px with sigma [F, J] px -> heatmaps [F, J, rows, columns] float16.

    Cell (i, j) holds score * exp(-d^2 / (2 sigma^2)), d the distance in px from the joint to the cell's centre (4j + 2,
    4i + 2): the Gaussian of height `score` sampled there, so the largest value is below the score by how far the joint
    is off a centre. A joint outside the picture `size` (width, height) leaves no mass, one inside near the border is
    cut there and not renormalised, and cells that lie in the padding beyond the picture stay 0. Values under 1e-3 are
    0; sigma is at least 2 px.
    """
    (width, height), (rows, columns) = size, grid
    u, v, score = (joints[..., i] for i in range(3))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    score = np.where(inside, score, 0.0)
    narrow = np.maximum(sigma, MIN_SIGMA)
    across = _bell(np.where(inside, u, 0.0), narrow, columns, width)
    down = _bell(np.where(inside, v, 0.0), narrow, rows, height) * score[..., None]
    out = down.astype(np.float32)[..., :, None] * across.astype(np.float32)[..., None, :]
    out[out < FLOOR] = 0
    return out.astype(np.float16)


def _bell(at: np.ndarray, sigma: np.ndarray, cells: int, pixels: int) -> np.ndarray:
    """[F, J] position and sigma, px -> [F, J, cells] Gaussian at the cell centres,
    0 in cells that start beyond `pixels`."""
    start = CELL * np.arange(cells)
    bell = np.exp(-0.5 * ((start + CELL / 2 - at[..., None]) / sigma[..., None]) ** 2)
    return np.where(start < pixels, bell, 0.0)
