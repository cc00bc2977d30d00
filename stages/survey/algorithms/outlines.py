"""Do given masks end where the subject ends? Their outlines against the pictures' own edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.stages.geometry.consistency import OFFSETS, REACH, change_across, typical_offset
from posegaussian.storage.model.masks import foreground

BESIDE = round(REACH) + 8
"""px around the subject in which its outline is compared: as far as edges are looked for, and the blur of the
outline's direction."""


def change_at_outline(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """`consistency.change_across` [n, K] of a picture [h, w, 3] uint8 and its mask [h, w]; none where sizes differ.

    At full resolution, in the part around the subject alone: the distances are the whole picture's.
    """
    rows, columns = (np.flatnonzero(foreground(mask).any(axis=axis)) for axis in (1, 0))
    if picture.shape[:2] != mask.shape or not len(rows):
        return np.zeros((0, len(OFFSETS)), np.float32)
    part = tuple(slice(max(0, int(at[0]) - BESIDE), int(at[-1]) + BESIDE + 1) for at in (rows, columns))
    return change_across(np.ascontiguousarray(picture[part]), np.ascontiguousarray(mask[part]))


def outline_offset(found: Sequence[np.ndarray]) -> np.ndarray:
    """[3]: captured px by which the outlines of some frames lie outside (+) their pictures' edges, the interquartile
    range of that from point to point, and how many points tell; 0 throughout where none does. Of what `found` of each,
    [n, K]."""
    change = np.concatenate([*found, np.zeros((0, len(OFFSETS)), np.float32)])
    if not len(change):
        return np.zeros(3)
    low, high = np.percentile(change @ OFFSETS, [25, 75])
    return np.array([typical_offset(change), high - low, len(change)])
