"""How far apart two sightings of people are, in body extents: the same measure in a picture and in space."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.joint_sets import joint_set

FLIPS = np.array(joint_set("coco17").flips)
"""Mirror image of each COCO-17 joint: a detector mirrors whom it sees from behind."""
FEWEST = 4
"""Joints that two sightings must share before they are compared."""


def extent(joints: np.ndarray) -> float:
    """Diagonal of the box of the known joints [J, D + 1], the last column their score; 0 of nobody."""
    known = joints[joints[:, -1] > 0, :-1]
    return float(np.linalg.norm(np.ptp(known, axis=0))) if len(known) else 0.0


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Median distance of the COCO-17 joints [17, D + 1] that both have, either as they are or one of them mirrored;
    infinite where they share too few."""
    return min(_apart(a, b), _apart(a[FLIPS], b))


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    both = (a[:, -1] > 0) & (b[:, -1] > 0)
    return float(np.median(np.linalg.norm((a - b)[both, :-1], axis=1))) if both.sum() >= FEWEST else np.inf


def centre(joints: np.ndarray) -> np.ndarray:
    """[D] median of the known joints [J, D + 1]."""
    return np.asarray(np.median(joints[joints[:, -1] > 0, :-1], axis=0))
