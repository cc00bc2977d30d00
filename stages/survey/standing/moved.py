"""Cameras that were moved in mid-take: by the silhouettes of its end they stand otherwise than by those before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from posegaussian.stages.imaging.small_turns import SIDE, turned
from posegaussian.stages.silhouettes.coherence import FEWEST, REST, Moved, Outlined, Standing, contradiction, standing
from posegaussian.storage.model.cameras import Rig

BY = 5.0
"""Px of a picture of `SIDE` px by which a camera was moved, at least, in the middle of its pictures. By single frames
of four cameras the turn of one that was moved by 22 varies by less than 1."""
ASKED = 2
"""Frames of the start, and of the end, that are asked."""


UNEQUAL = 0.3
"""Share of what the cameras contradict each other by in one part that they may in the other one, as they stand by some
frames of all, for it to be asked who was moved: wrong masks are as wrong at the start as at the end, and a search for
what turns them right takes its time."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A few frames of the take."""

    rig: Rig
    """Cameras as they are written down."""
    frames: Sequence[Outlined]
    """Their silhouettes."""

    @cached_property
    def views(self) -> set[int]:
        """That see something in all of its frames; nobody of too few to tell how one stands."""
        seen = set.intersection(*(set(f.silhouettes.views) for f in self.frames))
        return seen if len(seen) >= FEWEST else set()

    def contradiction(self, turns: np.ndarray) -> float:
        """Px by which its views contradict each other, turned by [V, 3] rad in their axes."""
        stand = turned(self.rig, turns)
        return contradiction(stand, [f.standing(stand) for f in self.frames], sorted(self.views))

    def turns(self, amid: np.ndarray) -> np.ndarray:
        """[V, 3] rad by which cameras stand turned by it, sought from the turns `amid` on."""
        stand = turned(self.rig, amid)
        return amid + standing(stand, [f.standing(stand) for f in self.frames]).turns


def without_moved(
    rig: Rig, numbers: Sequence[int] | np.ndarray, outlined: Callable[[int], Outlined], found: Standing
) -> Standing:
    """How cameras stand, with those that were moved between the first and the last of the frames `numbers` [F],
    ascending, told as moved.

    outlined: the silhouettes of one frame. found: how they stand by some of the frames, which is returned where nobody
    was moved; else it is found again without those that were.
    """
    if len(numbers) < 2 * ASKED:
        return found
    start, end = (_Part(rig, [outlined(int(n)) for n in few]) for few in (numbers[:ASKED], numbers[-ASKED:]))
    less, more = sorted(part.contradiction(found.turns) if part.views else 0.0 for part in (start, end))
    if more == 0 or less > UNEQUAL * more:
        return found
    before, after = start.turns(found.turns), end.turns(found.turns)
    who = otherwise(rig, before, after)
    if not who or not who <= start.views & end.views or not _each_against_the_other(start, end, before, after):
        return found
    first, last = _between(rig, numbers, outlined, before, after)
    moved = {v: Moved(first, last, after[v] - before[v]) for v in sorted(who)}
    rest = [f.among([v for v in f.silhouettes.views if v not in who]) for f in (*start.frames, *end.frames)]
    return replace(standing(rig, rest), moved=moved)


def _each_against_the_other(start: _Part, end: _Part, before: np.ndarray, after: np.ndarray) -> bool:
    """Whether either part says much less against its own turns than against those of the other one."""
    sides = ((start, before, after), (end, after, before))
    return all(part.contradiction(own) <= REST * part.contradiction(other) for part, own, other in sides)


def otherwise(rig: Rig, before: np.ndarray, after: np.ndarray) -> set[int]:
    """The cameras whose turns [V, 3] rad differ by at least `BY`."""
    px = rig.intrinsics[:, 0, 0] * SIDE / rig.size.max(axis=1)
    return {int(v) for v in np.flatnonzero(px * np.linalg.norm(after - before, axis=1) >= BY)}


def _between(
    rig: Rig,
    numbers: Sequence[int] | np.ndarray,
    outlined: Callable[[int], Outlined],
    before: np.ndarray,
    after: np.ndarray,
) -> tuple[int, int]:
    """The two frames between which cameras were moved that stand as in `before` [V, 3] first, then as in `after`."""
    first, last = ASKED - 1, len(numbers) - ASKED
    while last - first > 1:
        middle = (first + last) // 2
        part = _Part(rig, [outlined(int(numbers[middle]))])
        seen = bool(part.views) and part.contradiction(before) <= part.contradiction(after)
        first, last = (middle, last) if seen else (first, middle)
    return int(numbers[first]), int(numbers[last])
