"""Fewer Gaussians: blocks of pixels as one, for pages that must be small."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.exporters.page.maps import ViewMaps, present

JUMP = 8.0
"""Widths of a pixel by which neighbouring pixels of one surface differ in depth, at most."""


def merged(maps: ViewMaps, side: int) -> ViewMaps:
    """The maps of a camera with pixels `side` times as wide, [ceil(h / side), ceil(w / side)].

    A Gaussian is the mean, weighted by opacity, of those pixels of its block that lie on the surface in front, `side`
    times as large, and as opaque as they are times the share of the block that shows anything.
    """
    if side == 1:
        return maps
    there = _blocks(present(maps), side)
    depth = np.where(there, _blocks(maps.depth, side), np.inf).astype(np.float64)
    front = depth.min(axis=-1, keepdims=True)
    same = there & (depth <= front * (1 + JUMP * side / maps.focal))
    opacity = np.where(same, _blocks(maps.opacity, side), 0).astype(np.float64)
    weight = opacity[0]
    total = np.maximum(weight.sum(axis=-1), 1e-30)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray((np.where(same, _blocks(values, side), 0) * weight).sum(axis=-1) / total)

    shown = there.sum(axis=-1) / (side * side * np.maximum(same.sum(axis=-1), 1))
    return ViewMaps(
        np.rint(np.moveaxis(mean(np.moveaxis(maps.color, -1, 0)), 0, -1)).astype(np.uint8),
        mean(maps.depth),
        mean(maps.scale) * side,
        mean(maps.normal),
        opacity.sum(axis=-1) * shown,
        None if maps.twist is None else mean(maps.twist),
        maps.focal / side,
        None if maps.shift is None else mean(maps.shift) / side,
    )


def _blocks(values: np.ndarray, side: int) -> np.ndarray:
    """[..., ceil(h / side), ceil(w / side), side * side] of [..., h, w]; beside the picture is 0."""
    *before, height, width = values.shape
    rows, columns = -(-height // side), -(-width // side)
    room = [(0, 0)] * len(before) + [(0, rows * side - height), (0, columns * side - width)]
    cut = np.pad(values, room).reshape(*before, rows, side, columns, side)
    return np.moveaxis(cut, -3, -2).reshape(*before, rows, columns, side * side)
