"""Do the joints that cameras see meet in space? Residuals camera by camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.points import NEAR, project
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.storage.model.cameras import Rig

WITHIN = 0.01
"""Share of the picture's longer side within which a joint fits:
2 to 2.5 cm on a person who fills it, as far as detectors err."""
FEWEST = 8
"""Joints without which a camera is not judged: half of those that one frame shows of a body."""
AGREED = 1 / 16
"""Share of the joints a camera shows of its people that must be comparable with another's: fewer meet by chance."""


@dataclass(frozen=True)
class JointFit:
    """How one camera's joints fit those of all cameras."""

    count: int
    """Joints that could be compared."""
    median: float
    """Px from the triangulated joint's projection."""
    share: float
    """Share within `WITHIN`."""


def most_joints(people: np.ndarray) -> int:
    """Joints of at least `SCORE` of the one of people [n, J, 3] who shows most of them."""
    return int((people[..., 2] >= SCORE).sum(axis=-1).max(initial=0))


def joint_offsets(rig: Rig, seen: np.ndarray, space: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets [F, V, J, 2] px of joints seen [F, V, J, 3] from the projections of joints in space [F, J, 4], and
    which are known [F, V, J]."""
    pixels, depth = project(rig, space[..., :3])
    known = (seen[..., 2] > 0) & (space[..., 3] > 0)[:, None] & (np.moveaxis(depth, -1, 1) > NEAR)
    return np.where(known[..., None], seen[..., :2] - np.moveaxis(pixels, 2, 1), 0.0), known


def joint_fit(offsets: np.ndarray, known: np.ndarray, shown: int, longest: float) -> JointFit | None:
    """Of one camera: offsets [F, J, 2] px, known [F, J], of `shown` joints in all, `longest` px of its longer side;
    None with fewer than `FEWEST` joints, or than `AGREED` of all, to compare."""
    if known.sum() < max(FEWEST, AGREED * shown):
        return None
    off = np.linalg.norm(offsets, axis=-1)[known]
    return JointFit(len(off), float(np.median(off)), float((off <= WITHIN * longest).mean()))
