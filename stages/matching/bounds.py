"""Where the surface of one view can lie, and steps of inverse depth, in which both pictures and hypotheses are even."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Bounds:
    """Where the surface of one view can lie; all [h, w] float32, metres along its optical axis, 0 = no surface."""

    guide: np.ndarray
    """The surface the windows follow."""
    near: np.ndarray
    """Nearest depth searched."""
    far: np.ndarray
    """Farthest depth searched."""


def between(near: np.ndarray, far: np.ndarray, share: float) -> np.ndarray:
    """Depth at a share of the way from near to far in inverse depth, 0 where near is 0."""
    known = near > 0
    inverse = (1 - share) / np.where(known, near, 1) + share / np.where(known, far, 1)
    return np.where(known, 1 / inverse, 0).astype(np.float32)


def shifted(depth: np.ndarray, inverse_depth: float) -> np.ndarray:
    """Depth moved towards the camera by a step of inverse depth (away for a negative one), 0 where it is 0."""
    known = depth > 0
    return np.where(known, 1 / np.maximum(1 / np.where(known, depth, 1) + inverse_depth, 1e-3), 0).astype(np.float32)


def around(guide: np.ndarray, reach: float, near: np.ndarray, far: np.ndarray) -> Bounds:
    """Bounds a step of inverse depth to both sides of a guide, between near and far."""
    closer = np.maximum(shifted(guide, reach), near)
    return Bounds(guide, closer, np.maximum(closer, np.minimum(shifted(guide, -reach), far)))


def inverse(depth: np.ndarray) -> np.ndarray:
    """1 / depth [h, w] float32, and 0 where it is 0; its own inverse."""
    known = depth > 0
    return np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32)
