"""How differently cameras show the same patches of the body, beyond noise."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.imaging.color import to_srgb

FEWEST = 20
"""Shared patches below which their median is chance."""
BETWEEN = 0.95
"""Median difference of two pixels over their noise: sqrt(2) times the 0.6745 of a normal's median deviation."""


def disagreement(colors: np.ndarray, gains: np.ndarray, noise: float) -> tuple[float, int]:
    """(median difference between cameras on the patches they share, beyond noise, 1/255 sRGB; how many were compared).

    colors [S, 192, 3] linear light, 0 where not seen; gains [S, 3] that the pictures get; noise 1/255 sRGB. A patch is
    a median over pixels and frames, so noise is taken out as if a patch were one pixel: what is left is certain.
    """
    shown = to_srgb(colors * gains[:, None, :])
    known: np.ndarray = np.all(colors > 0, axis=2)
    apart = [
        np.abs(shown[a] - shown[b])[known[a] & known[b]].mean(axis=1) for a in range(len(colors)) for b in range(a)
    ]
    found = np.concatenate(apart) if apart else np.zeros(0)
    typical = float(np.median(found)) if len(found) else 0.0
    return float(np.sqrt(max(0.0, typical**2 - (BETWEEN * noise) ** 2))), len(found)
