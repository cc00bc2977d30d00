"""What gains are made of: features that cameras share, and what the judge's depth shows of the subject's surface."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from posegaussian.stages.contract.declaration import Evidence
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.judged import SHARED_LIGHT, may_judge
from posegaussian.stages.geometry.pairs import angle_at
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.exposure import NONE
from posegaussian.storage.model.cameras import Rig

SURFACE = "survey/surface"
"""Light at features that two cameras share, or at points of the hull."""
WIDEST = 75.0
"""Degrees between two views, seen from the subject, up to which they are compared on its surface."""


def compared(facts: Facts) -> str:
    """The array that tells how cameras' light differs: what the judge found to draw left-out views best, where they can
    be drawn."""
    return SHARED_LIGHT if may_judge(facts) else SURFACE


def side_by_side(rig: Rig, sources: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of source views that stand near enough to each other to be compared."""
    if len(sources) < 2:
        return []
    centre = look_at_point(rig.subset(list(sources)))
    pairs = combinations(sorted(sources), 2)
    return [(a, b) for a, b in pairs if angle_at(centre, *rig.centres[[a, b]]) <= WIDEST]


def points_of(features: np.ndarray, light: np.ndarray) -> np.ndarray:
    """[S, S, 64, 3] as `posegaussian.stages.imaging.exposure.match` takes them: of a pair whose surface was seen what
    depth shows of it, `light`, of every other one the features, both [S, S, 64, 3]."""
    seen = np.asarray((light < NONE).all(axis=(-2, -1)))  # a pair has all its points or none
    return np.where(seen[..., None, None], light, features)


def points_in(evidence: Evidence) -> np.ndarray:
    """The points of the source views that are noted; `compared` must be."""
    array, sources = compared(evidence.facts), list(evidence.sources)
    noted = evidence.noted[array]
    return noted[:, sources] if array == SURFACE else noted[np.ix_(sources, sources)]
