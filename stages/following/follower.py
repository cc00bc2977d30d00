"""People from frame to frame: a person goes on as whoever is where they were about to be, in body extents.

What is decided here is conservative: who is lost for longer than `gap` comes back as somebody new, and people who come
as near to each other as to be mistaken are noted. `identities` settles both with the people's looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from posegaussian.stages.following.assignment import matched
from posegaussian.stages.following.association import SAME, Seen, associate, canonical, distance
from posegaussian.stages.following.nearness import apart, centre, extent
from posegaussian.storage.model.cameras import Rig

STILL = 0.25
"""Body extents that a person's joints may be off where they are looked for."""
SPEED = 3.0
"""Body extents a second: a runner's."""
FARTHEST = 2.0
"""Body extents from one sighting to the next, at most, whatever the time between."""
COASTING = 0.25
"""Seconds that a person goes on as before; then they are looked for where they were seen last."""
CLOSE = 0.5
"""Body extents between the middles of two people who may be mistaken for each other."""


@dataclass(eq=False)
class Live:
    """A person while they are followed."""

    number: int
    """Counted from 0 in the order of appearance."""
    joints: np.ndarray
    """[17, D + 1] where each joint was seen last."""
    time: float
    """Seconds, of that."""
    speed: np.ndarray
    """[D] a second."""
    size: float
    """Extent."""

    def at(self, time: float) -> np.ndarray:
        """[17, D + 1] where the joints are expected at a time."""
        out = self.joints.copy()
        if 0 < time - self.time <= COASTING:
            out[:, :-1] += self.speed * (time - self.time)
        return out

    def see(self, joints: np.ndarray, time: float) -> None:
        """Go on from a new sighting; joints that it lacks move along with the others."""
        both = (joints[:, -1] > 0) & (self.joints[:, -1] > 0)
        moved = np.median((joints - self.joints)[both, :-1], axis=0) if both.any() else np.zeros(joints.shape[1] - 1)
        passed = time - self.time
        self.speed = 0.5 * self.speed + 0.5 * moved / passed if 0 < passed <= COASTING else 0.0 * self.speed
        kept = self.joints.copy()
        kept[:, :-1] += moved
        self.joints = np.where(joints[:, -1:] > 0, joints, kept)
        self.size = 0.9 * self.size + 0.1 * extent(joints)
        self.time = time


@dataclass
class Encounter:
    """Two people as near to each other as to be mistaken."""

    pair: tuple[int, int]
    """Their numbers."""
    first: int
    """Frame in which it begins."""
    last: int
    """The last frame of it."""
    nearest: int
    """The frame in which they are nearest."""
    distance: float
    """Their distance then, body extents."""


@dataclass(eq=False)
class Follower:
    """Follows everybody in the pictures of a rig; frames are given in order, each once."""

    rig: Rig
    gap: float
    """Seconds for which a person may be out of sight."""
    sparse: bool = False
    """Whether frames lie so far apart that people may have changed places from each to the next; then their looks tell
    them apart, as if all of them met."""
    encounters: list[Encounter] = field(default_factory=list)
    """Those that are over, in the order in which they ended."""
    live: list[Live] = field(default_factory=list)
    count: int = 0
    """People so far."""
    _open: dict[tuple[int, int], Encounter] = field(default_factory=dict)

    def step(self, frame: int, time: float, people: Sequence[np.ndarray]) -> tuple[list[np.ndarray], dict[int, Seen]]:
        """Go on by one frame: the number of each person [P_v] of each view, -1 for nobody's, and those who were
        placed, by number.

        people: V arrays [P_v, 17, 3] COCO-17 px of the rig, all of a single camera where the rig has one.
        """
        self.live = [p for p in self.live if time - p.time <= self.gap]
        if self.sparse:
            self.encounters += [_met(a, b, frame - 1) for a, b in combinations(self.live, 2)]
        seen = associate(self.rig, people) if len(self.rig) > 1 else _alone(people[0])
        numbers = [np.full(len(p), -1) for p in people]
        placed = self._go_on(time, seen)
        for number, person in placed.items():
            for v, i in enumerate(person.members):
                if i >= 0:
                    numbers[v][i] = number
        if len(self.rig) > 1:
            self._left_over(time, people, numbers)
        self._meet(frame, placed)
        return numbers, placed

    def finish(self) -> list[Encounter]:
        """All encounters by the frame of nearest approach."""
        over = [*self.encounters, *self._open.values()]
        return sorted(over, key=lambda e: (e.nearest, e.pair))

    def _go_on(self, time: float, seen: list[Seen]) -> dict[int, Seen]:
        """Who each sighting is: somebody followed so far, or somebody new."""
        placed: dict[int, Seen] = {}
        reach = np.array([min(STILL + SPEED * (time - p.time), FARTHEST) for p in self.live])
        off = np.array([[apart(p.at(time), s.joints) / max(p.size, 1e-9) for s in seen] for p in self.live])
        for i, j in matched(off.reshape(len(self.live), len(seen)), reach[:, None] if len(reach) else 1.0):
            self.live[i].see(seen[j].joints, time)
            placed[self.live[i].number] = seen[j]
        known = {id(s) for s in placed.values()}
        for s in seen:
            if id(s) not in known:
                dims = s.joints.shape[1] - 1
                self.live.append(Live(self.count, s.joints, time, np.zeros(dims), extent(s.joints)))
                placed[self.count] = s
                self.count += 1
        return placed

    def _left_over(self, time: float, people: Sequence[np.ndarray], numbers: list[np.ndarray]) -> None:
        """Give detections that no other view confirmed to those whom they lie on; nobody is placed by them."""
        for v, found in enumerate(people):
            free = [i for i in canonical(found) if numbers[v][i] < 0]
            missed = [p for p in self.live if p.number not in numbers[v]]
            off = np.array([[distance(self.rig, v, p.at(time), found[i]) for i in free] for p in missed])
            for a, b in matched(off.reshape(len(missed), len(free)), SAME):
                numbers[v][free[b]] = missed[a].number

    def _meet(self, frame: int, placed: dict[int, Seen]) -> None:
        """Open, go on with and close the encounters of those who are placed."""
        middles = {n: centre(s.joints) for n, s in sorted(placed.items())}
        sizes = {p.number: p.size for p in self.live}
        names = list(middles)
        for a_at, a in enumerate(names):
            for b in names[a_at + 1 :]:
                off = float(np.linalg.norm(middles[a] - middles[b])) / max(sizes[a], sizes[b], 1e-9)
                known = self._open.get((a, b))
                if off < CLOSE and known is None:
                    self._open[a, b] = Encounter((a, b), frame, frame, frame, off)
                elif off < CLOSE and known is not None:
                    known.last = frame
                    if off < known.distance:
                        known.nearest, known.distance = frame, off
                elif known is not None:
                    self.encounters.append(self._open.pop((a, b)))
        alive = {p.number for p in self.live}
        for pair in [p for p in self._open if not alive.issuperset(p)]:
            self.encounters.append(self._open.pop(pair))


def _met(a: Live, b: Live, frame: int) -> Encounter:
    """That of two people who may have changed places behind a frame."""
    return Encounter((a.number, b.number), frame, frame, frame, 0.0)


def _alone(people: np.ndarray) -> list[Seen]:
    """The people of a single view, px."""
    return [Seen(np.array([i]), people[i]) for i in canonical(people)]
