"""Where the surface of one view can lie, and steps of inverse depth, in which both pictures and hypotheses are even."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SEARCHED = 0.6
"""Share of the hull's thickness, in inverse depth, that is searched: a visible surface lies in the front half of its
hull but for phantoms."""
IN_FRONT = 0.006
"""Disparity by which a surface may lie in front of its hull, px over the picture's longer side: 3 px at 512, about
what a mask or a calibration that is a pixel off costs."""


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


def within_hull(near: np.ndarray, far: np.ndarray, in_front: float) -> Bounds:
    """Bounds of the first search of a view whose hull lies between near and far; `in_front` is the step of inverse
    depth by which `IN_FRONT` moves a point."""
    return Bounds(near, shifted(near, in_front), between(near, far, SEARCHED))


def inverse(depth: np.ndarray) -> np.ndarray:
    """1 / depth [h, w] float32, and 0 where it is 0; its own inverse."""
    known = depth > 0
    return np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32)
