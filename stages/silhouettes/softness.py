"""Over how many pixels masks rise at their outlines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from posegaussian.storage.model.masks import foreground

TENTH, NINE_TENTHS = 26, 229
"""Values of a mask between which it neither leaves a pixel nor takes it."""


def softness(masks: Iterable[np.ndarray]) -> float:
    """Px over which masks [h, w] uint8 rise from a tenth to nine tenths at their outlines, the median mask's: about 1
    where they are exact, 0 where none has an outline."""
    widths = [width for mask in masks if (width := _width(mask)) is not None]
    return float(np.median(widths)) if widths else 0.0


def _width(mask: np.ndarray) -> float | None:
    """Pixels between the two values for every side of a pixel that the outline follows, of which a straight one has 1
    to 1.41 for each px of its length; None without one."""
    inside = foreground(mask)
    length = int((inside[:, 1:] != inside[:, :-1]).sum() + (inside[1:] != inside[:-1]).sum())
    return float(((mask > TENTH) & (mask < NINE_TENTHS)).sum()) / length if length else None
