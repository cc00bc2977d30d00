"""Which source picture judges, and in which order the others teach."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.refinement.params import FEWEST
from posegaussian.stages.rendering.sources import angles_at, choose
from posegaussian.storage.model.cameras import Rig

NEIGHBOURS = 2
"""Views whose Gaussians make a picture without refinement, as `rendering.sources` has it."""


@dataclass(frozen=True)
class Schedule:
    """Who judges and who teaches in one frame."""

    judge: int
    """View whose picture is never trained on, and is rendered from the other views' Gaussians alone."""
    neighbours: tuple[tuple[int, float], ...]
    """(view, weight of its opacities) that make the judge's picture without refinement."""
    pupils: tuple[int, ...]
    """The other views, in the order in which their pictures are trained on; after the last comes the first."""


def schedule(rig: Rig, sources: tuple[int, ...], usable: np.ndarray) -> Schedule | None:
    """The schedule of a frame whose `usable` [V] bool views have a picture and Gaussians; None with fewer than `FEWEST`
    of them.

    The judge is the view with the nearest neighbours, the first of equals (1e-3 rad): its picture is rendered most like
    those in between.
    """
    views = [v for v in sources if usable[v]]
    if len(views) < FEWEST:
        return None
    subject = look_at_point(rig.subset(sources))
    angles = {v: angles_at(subject, rig.centres, rig.centres[v]) for v in views}
    judge = min(
        views, key=lambda v: (round(float(np.sort(angles[v][[u for u in views if u != v]])[:NEIGHBOURS].max()), 3), v)
    )
    others = [v for v in views if v != judge]
    return Schedule(
        judge, tuple(choose(angles[judge], np.isin(np.arange(len(rig)), others), NEIGHBOURS)), _apart(others)
    )


def _apart(views: list[int]) -> tuple[int, ...]:
    """The views in an order in which neighbours in the list are not neighbours in the list given."""
    n = len(views)
    stride = next((s for s in range(max(n // 2, 1), 0, -1) if gcd(s, n) == 1), 1)
    return tuple(views[i * stride % n] for i in range(n))
