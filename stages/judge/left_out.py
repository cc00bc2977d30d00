"""Which source views are left out and drawn from the others: those whose picture a run would draw, too."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from posegaussian.stages.geometry.pairs import angle_between
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.storage.model.cameras import Rig

STRAIGHT = 120.0
"""Degrees at a view between its directions towards two others, as the subject sees all three, from which on it is
between them. Neighbours on a ring that looks down by 30 degrees are 127 apart at one of four, more at one of more."""
HALF_ROUND = 185.0
"""Degrees from one view over a second to a third, at the subject, up to which the second stands between them: what lies
behind the subject is beside nobody."""
FEWEST = 2
"""Views between others, at least; of fewer, with as few pictures, all are judged."""


def left_out(rig: Rig, sources: Sequence[int], count: int) -> list[int]:
    """At most `count` of the source views, spread evenly: of those that stand between two others, or of all where fewer
    than two do, for one picture says little.

    At the end of an arc a view is drawn from outside: depth that a run never shows from there counts, and what helps
    between the cameras harms beyond them.
    """
    between = [v for v in sources if _between(rig, v, sources)]
    judged = between if len(between) >= FEWEST else list(sources)
    return [judged[i] for i in np.unique(np.linspace(0, len(judged) - 1, count).round().astype(int))]


def _between(rig: Rig, view: int, sources: Sequence[int]) -> bool:
    """Whether a view stands between two others, as the subject sees them."""
    subject = look_at_point(rig.subset(list(sources)))
    own, others = rig.centres[view] - subject, [rig.centres[v] - subject for v in sources if v != view]
    across = [o - (o @ own) / (own @ own) * own for o in others]
    return any(
        angle_between(across[a], across[b]) >= STRAIGHT
        and angle_between(own, others[a]) + angle_between(own, others[b]) <= HALF_ROUND
        for a, b in combinations(range(len(others)), 2)
    )
