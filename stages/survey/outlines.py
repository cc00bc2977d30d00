"""Do given masks end where the subject ends? Their outlines against the pictures' own edges."""

from __future__ import annotations

import numpy as np

from stages.frames.display import to_display
from stages.geometry.consistency import silhouette_offset
from stages.io import Inputs

FRAMES = 5
"""Sampled frames that are looked at."""


def outline_of_view(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """[3]: median distance of the outline outside the picture's edge and its interquartile range, captured px, and how many outline points have an edge.

    Over a few of the sampled source frames `numbers` of a source view; 0 throughout where there is none.
    """
    if view not in inputs.views.sources or not len(numbers):
        return np.zeros(3)
    chosen = [int(n) for n in np.unique(np.asarray(numbers)[np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), FRAMES))).astype(int)])]
    pictures, masks = (inputs.source(kind).read(view, chosen) for kind in ("pictures", "masks"))
    found = [silhouette_offset(to_display(p), m) for p, m in zip(pictures, masks, strict=True) if p.shape[:2] == m.shape]
    offsets = np.concatenate(found) if found else np.zeros(0)
    if not len(offsets):
        return np.zeros(3)
    low, median, high = np.percentile(offsets, [25, 50, 75])
    return np.array([median, high - low, len(offsets)])
