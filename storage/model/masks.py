"""Masks as data: where a pixel belongs to the subject."""

from __future__ import annotations

import numpy as np

FOREGROUND = 127
"""A mask value above this is foreground: at least half of the pixel is covered."""


def foreground(mask: np.ndarray) -> np.ndarray:
    """[...] uint8 mask, 0..255 -> bool."""
    return mask > FOREGROUND
