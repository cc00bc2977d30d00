"""Masks as data: where a pixel belongs to the subject."""

from __future__ import annotations

import numpy as np

FOREGROUND = 127
"""A mask value above this is foreground: at least half of the pixel is covered."""


def foreground(mask: np.ndarray) -> np.ndarray:
    """[...] uint8 mask, 0..255 -> bool."""
    return mask > FOREGROUND


def rim_share(inside: np.ndarray) -> float:
    """Share of the picture's outermost pixels that are foreground, [h, w] bool."""
    rows, columns = inside[[0, -1]], inside[1:-1, [0, -1]]
    return float((rows.sum() + columns.sum()) / (rows.size + columns.size))


ROUND = 0.75
"""Share of a picture's rim beyond which a mask goes around the picture, and not a subject through it: it marks the
background, or nothing is cut out. A person filmed so near that only the head is whole has half of it."""
