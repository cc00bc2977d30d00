"""Do given masks end where the subject ends? Their outlines against the pictures' own edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.stages.geometry.consistency import REACH, silhouette_offset
from posegaussian.storage.model.masks import foreground

BESIDE = round(REACH) + 8
"""px around the subject in which its outline is compared: as far as edges are looked for, and the blur of the
outline's direction."""


def outline_offsets(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[n] captured px by which the outline of a mask [h, w] lies outside (+) the edge of its picture [h, w, 3] uint8;
    none where sizes differ.

    At full resolution, in the part around the subject alone: the distances are the whole picture's.
    """
    rows, columns = (np.flatnonzero(foreground(mask).any(axis=axis)) for axis in (1, 0))
    if picture.shape[:2] != mask.shape or not len(rows):
        return np.zeros(0)
    part = tuple(slice(max(0, int(at[0]) - BESIDE), int(at[-1]) + BESIDE + 1) for at in (rows, columns))
    return silhouette_offset(np.ascontiguousarray(picture[part]), np.ascontiguousarray(mask[part]))


def typical_offset(found: Sequence[np.ndarray]) -> np.ndarray:
    """[3]: median of the offsets of some frames and their interquartile range, captured px, and how many points
    tell; 0 throughout where none does."""
    offsets = np.concatenate([*found, np.zeros(0)])
    if not len(offsets):
        return np.zeros(3)
    low, median, high = np.percentile(offsets, [25, 50, 75])
    return np.array([median, high - low, len(offsets)])
