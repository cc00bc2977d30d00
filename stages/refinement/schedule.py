"""Which source picture judges, which ones teach, and from whose Gaussians each is rendered."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np

from stages.geometry.subject import look_at_point
from stages.rendering.sources import angles_at, choose
from storage.rig import Rig

FEWEST = 3
"""Usable source views: one judges, and the picture of a second is rendered from a third."""
NEIGHBOURS = 2
"""Views whose Gaussians make a picture, as `rendering.sources` has it."""

Parts = tuple[tuple[int, float], ...]
"""(view, weight of its opacities) whose Gaussians make a picture."""


@dataclass(frozen=True)
class Lesson:
    """One picture to render."""

    target: int
    """View whose picture it is compared with."""
    parts: Parts
    """Whose Gaussians are rendered."""


@dataclass(frozen=True)
class Schedule:
    """The lessons of one frame."""

    judge: Lesson
    """Never trained on; rendered from the other views alone."""
    lessons: tuple[Lesson, ...]
    """In order; after the last comes the first."""

    @property
    def courses(self) -> tuple[tuple[Lesson, ...], ...]:
        """All lessons, and those alone that show no Gaussians in their own picture: which teaches more depends on the scene, and the judge tells."""
        return self.lessons, tuple(x for x in self.lessons if x.target not in {v for v, _ in x.parts})


def schedule(rig: Rig, sources: tuple[int, ...], usable: np.ndarray) -> Schedule | None:
    """The lessons of a frame whose `usable` [V] bool views have a picture and Gaussians; None with fewer than `FEWEST` of them.

    The judge is the view with the nearest neighbours, the first of equals (1e-3 rad): its picture is rendered most like those
    in between. Every other view teaches in turn: first its picture is rendered from its neighbours, chosen and weighted
    as rendering does, then from itself and one neighbour, so that what intrudes from there shows and what is its own stays
    sharp. The second is left out for a view whose Gaussians make no other view's picture: they would see their own alone.
    """
    views = [v for v in sources if usable[v]]
    if len(views) < FEWEST:
        return None
    subject = look_at_point(rig.subset(sources))
    angles = {v: angles_at(subject, rig.centres, rig.centres[v]) for v in views}
    others = {v: tuple(choose(angles[v], np.isin(np.arange(len(rig)), [u for u in views if u != v]), NEIGHBOURS)) for v in views}
    judge = min(views, key=lambda v: (round(float(np.sort(angles[v][[u for u in views if u != v]])[:NEIGHBOURS].max()), 3), v))
    pupils = _apart([v for v in views if v != judge])
    taught = {u for v in pupils for u, _ in others[v]}
    lessons = []
    for turn in range(NEIGHBOURS):
        for v in pupils:
            lessons.append(Lesson(v, others[v]))
            if v in taught:
                lessons.append(Lesson(v, ((v, 1.0), (others[v][turn % len(others[v])][0], 1.0))))
    return Schedule(Lesson(judge, others[judge]), tuple(lessons))


def _apart(views: list[int]) -> list[int]:
    """The views in an order in which neighbours in the list are not neighbours in the list given."""
    n = len(views)
    stride = next((s for s in range(max(n // 2, 1), 0, -1) if gcd(s, n) == 1), 1)
    return [views[i * stride % n] for i in range(n)]
