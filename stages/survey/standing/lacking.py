"""Whose masks lack something that those of the others have: a limb, the feet, what is held.

Such a mask carves from the others what they agree on, and does not contradict itself: the rays through its own rim meet
what the others show, which those of a camera that stands elsewhere, or is out of step, do not. So of the masks that
contradict the others least the fewest are sought without which all the others are coherent, and with which each is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from posegaussian.stages.imaging.small_turns import SIDE
from posegaussian.stages.silhouettes.coherence import (
    CURED,
    FEWEST,
    INCOHERENT,
    Outlined,
    clear,
    contradiction,
    mean_by_view,
)
from posegaussian.storage.model.cameras import Rig

MOST = 4
"""Masks, at most, that are told, of fewer than half of the views."""
SUSPECTED = 8
"""Masks, at most, of which sets are tried: those that contradict the others least themselves."""
OWN = 0.03
"""Px of 512, mean over its rim, by which a mask that lacks something may contradict the others itself. Feet, legs and a
helmet cut from two to four of 8 and 16 masks: 0.000 to 0.007; one that is inverted 0.14."""


def lacking(rig: Rig, frames: Sequence[Outlined]) -> frozenset[int]:
    """Views whose masks lack something, with the cameras as they stand in `rig`; none where it is not clear whose."""
    frames = [f for f in frames if len(f.silhouettes.views) >= FEWEST]
    views = sorted(set.intersection(*(set(f.silhouettes.views) for f in frames))) if frames else []
    if len(views) < FEWEST:
        return frozenset()
    frames, pixel = [f.standing(rig) for f in frames], float(rig.size.max()) / SIDE
    before = contradiction(rig, frames, views)
    if before < INCOHERENT * pixel:
        return frozenset()
    own = mean_by_view(rig, frames, views)
    suspected = sorted((v for v in views if own[v] < before), key=lambda v: (own[v], v))[:SUSPECTED]
    doubted = [f.doubted(rig) for f in frames]
    for size in range(1, min(MOST, (len(views) - 1) // 2, len(suspected)) + 1):
        sets = map(frozenset, combinations(suspected, size))
        rest = {s: contradiction(rig, doubted, [v for v in views if v not in s]) for s in sets}
        best = clear(rest, before)
        if best is not None and rest[best] <= CURED * before:
            right = [v for v in views if v not in best]
            fits = all(mean_by_view(rig, frames, [*right, v])[v] <= OWN * pixel for v in best)
            return best if fits else frozenset()
    return frozenset()
