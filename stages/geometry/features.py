"""Features that two pictures share: SIFT (Lowe 2004, as RootSIFT: Arandjelovic and Zisserman 2012), matched both
ways with a ratio test."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.storage.model.cameras import points_from_integer_centres

FEATURES = 6000
"""Features of a picture, strongest first."""
RATIO = 0.85
"""Largest angle between two descriptors over that of the second best match."""


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one picture."""

    points: np.ndarray
    """[n, 2] px, our pixel centres."""
    descriptors: np.ndarray
    """[n, 128] float32 of unit length."""


def features(picture: np.ndarray, coverage: np.ndarray) -> Features:
    """Of [h, w, 3] uint8 where `coverage` [h, w] uint8 is not 0, a few pixels from its border."""
    gray = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    inside = cv2.erode(coverage, np.ones((9, 9), np.uint8), borderValue=0)
    # A lower contrast than Lowe's .04: floors and clothes are plain.
    keypoints, descriptors = cv2.SIFT_create(FEATURES, contrastThreshold=0.02).detectAndCompute(gray, inside)  # type: ignore[attr-defined]
    if descriptors is None or not len(descriptors):
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    points = points_from_integer_centres(np.array([k.pt for k in keypoints]))
    # A place with two orientations is listed twice and would match itself.
    _, first = np.unique(points.round(2), axis=0, return_index=True)
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))
    return Features(points[np.sort(first)], root[np.sort(first)].astype(np.float32))


def matched(first: Features, second: Features) -> np.ndarray:
    """[n, 2] indices of features that are each other's best match,
    clearly better than the second best in both pictures."""
    if min(len(first.points), len(second.points)) < 3:
        return np.zeros((0, 2), dtype=np.int64)
    likeness = first.descriptors @ second.descriptors.T
    there, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    here = np.arange(len(there))
    clear = _ratio(likeness)[here] < RATIO, _ratio(likeness.T)[there] < RATIO
    kept = (back[there] == here) & clear[0] & clear[1]
    return np.stack([here[kept], there[kept]], axis=1)


def _ratio(likeness: np.ndarray) -> np.ndarray:
    """[n] angle to the best over the angle to the second best, of cosines [n, m]."""
    two = np.partition(likeness, likeness.shape[1] - 2, axis=1)[:, -2:]
    angle = np.arccos(np.clip(two.astype(np.float64), -1.0, 1.0))
    return np.asarray(angle[:, 1] / np.maximum(angle[:, 0], 1e-9))
