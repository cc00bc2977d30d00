"""Pictures of what stands still, averaged over time: noise goes, motion stays as it was filmed.

A pixel is averaged with itself in the frames around, each by how likely its neighbourhood is the same surface under
other noise: non-local means (Buades, Coll and Morel, 2005) whose search is over time alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

PATCH = 5
"""Side of the neighbourhood that must be the same, px."""


def averaged(picture: np.ndarray, others: Sequence[np.ndarray], noise: float) -> np.ndarray:
    """A picture [h, w, 3] uint8, averaged with others of the same camera where these show the same.

    A neighbour's weight is exp(-max(0, d - 2 s²) / (2 s²)), with d the mean squared difference over `PATCH` px and the
    channels; noise of standard deviation s (`noise`, 1/255) alone makes 2 s² of it. A pixel that differs by more than a
    few s is left as it is. Without noise, or without others, the picture itself.
    """
    if noise <= 0 or not others:
        return picture
    total, weights = picture.astype(np.float32), np.ones(picture.shape[:2], np.float32)
    own = total.copy()
    for other in others:
        there = other.astype(np.float32)
        apart = cv2.blur(((own - there) ** 2).mean(axis=2), (PATCH, PATCH), borderType=cv2.BORDER_REPLICATE)
        weight = np.exp(-np.maximum(apart / (2 * noise**2) - 1, 0))
        total += weight[..., None] * there
        weights += weight
    return np.rint(total / weights[..., None]).astype(np.uint8)
