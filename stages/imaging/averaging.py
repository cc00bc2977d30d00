"""What stands still, averaged over time: noise goes, motion stays as it was filmed.

A pixel is averaged with itself in the frames around, each by how likely its neighbourhood is the same surface under
other noise: non-local means (Buades, Coll and Morel, 2005) whose search is over time alone. So are pictures, and the
depth that was found in them.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled

PATCH = 5
"""Side of the neighbourhood that must be the same, px."""
REACH = 2.0
"""Pixel footprints (depth / focal length) within which depths are noise of one surface."""


def averaged(picture: np.ndarray, others: Sequence[np.ndarray], noise: float) -> np.ndarray:
    """A picture [h, w, 3] uint8, averaged with others of the same camera where these show the same, each by its
    `sameness`. Without noise, or without others, the picture itself."""
    if noise <= 0 or not others:
        return picture
    total, weights = picture.astype(np.float32), np.ones(picture.shape[:2], np.float32)
    for other in others:
        weight = sameness(picture, other, noise)
        total += weight[..., None] * other.astype(np.float32)
        weights += weight
    return np.rint(total / weights[..., None]).astype(np.uint8)


def sameness(picture: np.ndarray, other: np.ndarray, noise: float) -> np.ndarray:
    """[h, w] float32, 0..1: how much a picture [h, w, 3] uint8 shows the same as another of the same camera.

    It is exp(-max(0, d - 2 s²) / (2 s²)), with d the mean squared difference over `PATCH` px and the channels; noise of
    standard deviation s (`noise`, 1/255, above 0) alone makes 2 s² of it. A pixel that differs by more than a few s has
    nothing in common.
    """
    apart = ((picture.astype(np.float32) - other.astype(np.float32)) ** 2).mean(axis=2)
    apart = cv2.blur(apart, (PATCH, PATCH), borderType=cv2.BORDER_REPLICATE)
    return np.exp(-np.maximum(apart / (2 * noise**2) - 1, 0))


@compiled
def averaged_depth(
    depths: np.ndarray, confidences: np.ndarray, weights: np.ndarray, own: int, footprint: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depth [h, w] and confidence [h, w], float32, of frame `own` of [K, h, w] depths in metres (0: none) with their
    confidences and the frames' `weights` 0..1, which is 1 for the frame itself; `footprint`: 1 / focal length.

    Matches flip between two surfaces, which a mean would bridge: the weighted median, in inverse depth, says which
    surface it is, and what lies within `REACH` of it is averaged, less the farther. Half of the weight must be other
    frames' before they overrule the frame itself. What has no depth in the frame keeps none.
    """
    count, height, width = depths.shape
    depth, confidence = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    values, shares = np.zeros(count), np.zeros(count)
    for i in range(height):
        for j in range(width):
            if depths[own, i, j] <= 0:
                continue
            for k in range(count):
                known = depths[k, i, j] > 0
                values[k] = 1 / depths[k, i, j] if known else 0.0
                shares[k] = weights[k, i, j] if known else 0.0
            half, order, passed, at = shares.sum() / 2, np.argsort(values), 0.0, 0
            while passed + shares[order[at]] < half:
                passed += shares[order[at]]
                at += 1
            middle = values[order[at]]
            total, weight, sure = 0.0, 0.0, 0.0
            for k in range(count):
                apart = (values[k] - middle) / (REACH * footprint * middle)
                share = shares[k] * max(0.0, 1 - apart * apart)
                total += share * values[k]
                sure += share * confidences[k, i, j]
                weight += share
            depth[i, j] = weight / total
            confidence[i, j] = sure / weight
    return depth, confidence
