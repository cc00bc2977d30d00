"""Everybody in a sequence: who was seen when and where, gathered frame by frame in memory that holds joints of one
frame and a few numbers of each sighting."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from posegaussian.stages.following.appearance import together
from posegaussian.stages.following.follower import Encounter, Follower
from posegaussian.stages.following.identities import Piece, cuts_of, exchanged, pieces_of, rejoined
from posegaussian.stages.following.nearness import centre, extent
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

CANDIDATES = 16
"""People of a picture that are followed."""
LOOKS = 5
"""Frames in which a piece's looks are taken."""
BETWEEN = 1.5
"""Times the usual interval between frames for which people are looked for where they went, whatever `gap` says: of
frames that lie seconds apart, each shows them elsewhere."""
LEAST_FRAMES = 3
"""Frames in which a person must be seen to count, or all that show anybody where these are fewer; phantoms of a
detector come and go."""
_NAMES = joint_set("coco17").names
_BONES = np.array(
    [[_NAMES.index(s + a), _NAMES.index(s + b)] for s in "LR" for a, b in (("Hip", "Knee"), ("Knee", "Ankle"))]
    + [
        [_NAMES.index(s + a), _NAMES.index(s + b)]
        for s in "LR"
        for a, b in (("Shoulder", "Elbow"), ("Shoulder", "Hip"))
    ]
)

Frame = tuple[int, float, Sequence[np.ndarray]]
"""(index, seconds, [17, 3] COCO-17 px of every person of every view)."""
LookAt = dict[int, dict[int, list[tuple[int, int, int]]]]
"""{view: {frame: [(index of the person in the picture, number, piece)]}}."""


@dataclass(eq=False)
class Everybody:
    """What following found; numbers are the follower's until `settle`."""

    numbers: np.ndarray
    """[F, V, C] int32 who each detection is; -1 nobody."""
    spans: np.ndarray
    """[F, V, C] float32 extent of each detection over the picture's longest side."""
    times: np.ndarray
    """[F] seconds."""
    encounters: list[Encounter] = field(default_factory=list)
    places: dict[int, list[tuple[int, np.ndarray]]] = field(default_factory=lambda: defaultdict(list))
    """{number: [(frame, middle [D])]} of those who were placed."""
    sizes: dict[int, float] = field(default_factory=dict)
    """{number: mean extent}."""
    bones: dict[int, np.ndarray] = field(default_factory=dict)
    """{number: mean lengths [8], 0 = unknown}."""
    least: int = LEAST_FRAMES
    """Frames in which a person must be seen to count."""

    @classmethod
    def of(
        cls, rig: Rig, frames: Iterable[Frame], times: np.ndarray, gap: float, least: int = LEAST_FRAMES
    ) -> Everybody:
        """Follow everybody; frames in order. Where the rig has one camera, in its picture.

        Who is seen in fewer than `least` frames does not count, or in fewer than show anybody in two of the pictures.
        """
        between = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        follower = Follower(rig, max(gap, BETWEEN * between), sparse=between > gap)
        shape = (len(times), len(rig), CANDIDATES)
        out, shown = cls(np.full(shape, -1, np.int32), np.zeros(shape, np.float32), times), 0
        sums: dict[int, np.ndarray] = defaultdict(lambda: np.zeros((2, len(_BONES) + 1)))
        for f, time, people in frames:
            numbers, placed = follower.step(f, time, people)
            shown += sum(bool((found[..., 2] > 0).any()) for found in people) >= min(2, len(rig))
            for v, found in enumerate(people):
                out.numbers[f, v, : len(found)] = numbers[v]
                out.spans[f, v, : len(found)] = [extent(p) / rig.size[v].max() for p in found]
            for number, seen in placed.items():
                out.places[number].append((f, centre(seen.joints)))
                sums[number] += _measured(seen.joints)
        out.least = max(1, min(least, shown))
        mean = {n: s[0] / np.maximum(s[1], 1) for n, s in sums.items()}
        out.sizes, out.bones = {n: float(m[-1]) for n, m in mean.items()}, {n: m[:-1] for n, m in mean.items()}
        out.encounters = follower.finish()
        return out

    def look_at(self) -> LookAt:
        """Where to look to tell people apart; nowhere where there is one person."""
        wanted: LookAt = defaultdict(lambda: defaultdict(list))
        if len(self.places) < 2:
            return wanted
        close = self._in_company()
        for number in sorted(self.places):
            frames = np.array([f for f, _ in self.places[number]])
            if len(frames) < self.least and not cuts_of(self.encounters, number):
                continue
            for piece, own in enumerate(pieces_of(frames, cuts_of(self.encounters, number))):
                apart = own[~np.isin(own, close[number])]
                chosen = apart if len(apart) else own
                for f in (
                    chosen[np.unique(np.linspace(0, len(chosen) - 1, LOOKS).round().astype(int))] if len(chosen) else ()
                ):
                    for v, i in zip(*np.nonzero(self.numbers[f] == number), strict=True):
                        wanted[int(v)][int(f)].append((int(i), number, piece))
        return wanted

    def settle(self, looks: dict[tuple[int, int], np.ndarray], gap: float) -> None:
        """Put exchanged people right, join who came back, drop who hardly was there, and number the rest from 0 by
        the pictures that show them."""
        swaps = exchanged(self.encounters, looks)
        pieces, of_person = self._pieces(swaps, looks)
        root = rejoined(pieces, of_person, self.times, gap)
        who = np.arange(-1, max([*self.places, -1]) + 1)  # who[n + 1]: whom the follower's n is now
        begin = 0
        for frame, a, b in [*swaps, (len(self.times) - 1, -1, -1)]:
            lut = np.array([root.get(int(n), int(n)) for n in who], dtype=np.int32)
            self.numbers[begin : frame + 1] = lut[self.numbers[begin : frame + 1] + 1]
            begin = frame + 1
            who[[a + 1, b + 1]] = who[[b + 1, a + 1]]
        self.places = self._places(swaps, root)
        self._rank()

    def _in_company(self) -> dict[int, np.ndarray]:
        """{number: frames in which somebody is near}."""
        found: dict[int, list[np.ndarray]] = defaultdict(list)
        for e in self.encounters:
            for n in e.pair:
                found[n].append(np.arange(e.first, e.last + 1))
        return defaultdict(lambda: np.zeros(0, np.int64), {n: np.unique(np.concatenate(x)) for n, x in found.items()})

    def _pieces(
        self, swaps: Sequence[tuple[int, int, int]], looks: dict[tuple[int, int], np.ndarray]
    ) -> tuple[list[Piece], dict[int, np.ndarray]]:
        """Everybody after exchanges, each in one piece, and how they look."""
        places, pieces = self._places(swaps, {}), []
        taken: dict[int, list[np.ndarray]] = defaultdict(list)
        for (number, piece), histogram in sorted(looks.items(), key=lambda x: x[0]):
            cuts = cuts_of(self.encounters, number)
            turns, whom = _history(swaps, number)
            taken[whom[int(np.searchsorted(turns, cuts[piece - 1] + 1))] if piece else number].append(histogram)
        for number, found in sorted(places.items()):
            frames = np.array([f for f, _ in found])
            pieces.append(Piece(number, frames, found[0][1], found[-1][1], self.sizes[number], self.bones[number]))
        return pieces, {n: together(x) for n, x in taken.items()}

    def _places(
        self, swaps: Sequence[tuple[int, int, int]], root: dict[int, int]
    ) -> dict[int, list[tuple[int, np.ndarray]]]:
        """Where everybody was after exchanges and joins, by frame."""
        out: dict[int, list[tuple[int, np.ndarray]]] = defaultdict(list)
        for number, found in sorted(self.places.items()):
            turns, whom = _history(swaps, number)
            for f, middle in found:
                who = whom[int(np.searchsorted(turns, f))]
                out[root.get(who, who)].append((f, middle))
        return {n: sorted(x, key=lambda y: y[0]) for n, x in out.items()}

    def _rank(self) -> None:
        """Number people anew by how many pictures show them, the earlier first of equals; -1 who was hardly there."""
        kept = [n for n, x in self.places.items() if len(x) >= self.least]
        pictures = np.bincount(self.numbers[self.numbers >= 0], minlength=max([*self.places, -1]) + 1)
        kept.sort(key=lambda n: (-int(pictures[n]), self.places[n][0][0], n))
        lut = np.full(len(pictures) + 1, -1, dtype=np.int32)
        lut[np.array(kept[:CANDIDATES], dtype=np.int64) + 1] = np.arange(len(kept[:CANDIDATES]))
        self.numbers = lut[self.numbers + 1]
        self.sizes = {i: self.sizes[n] for i, n in enumerate(kept[:CANDIDATES])}
        self.places = {i: self.places[n] for i, n in enumerate(kept[:CANDIDATES])}


def _history(swaps: Sequence[tuple[int, int, int]], number: int) -> tuple[list[int], list[int]]:
    """(frames after which the follower's `number` is somebody else, whom it is before the first and after each)."""
    who: dict[int, int] = {}
    turns, whom = list[int](), [number]
    for frame, a, b in swaps:
        who[a], who[b] = who.get(b, b), who.get(a, a)
        if number in (a, b):
            turns.append(frame)
            whom.append(who[number])
    return turns, whom


def _measured(joints: np.ndarray) -> np.ndarray:
    """[2, 9] lengths of bones and the extent, and which are known, of one sighting; in a picture bones have no
    length."""
    known = joints[:, -1] > 0
    both = known[_BONES].all(axis=1) & (joints.shape[1] == 4)
    lengths = np.linalg.norm(joints[_BONES[:, 0], :-1] - joints[_BONES[:, 1], :-1], axis=1)
    return np.stack([np.append(np.where(both, lengths, 0.0), extent(joints)), np.append(both, True)])
