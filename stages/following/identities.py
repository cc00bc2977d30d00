"""Who is who over the whole sequence, from people followed piece by piece: exchanged where two met and their looks say
so, and known again where somebody left and came back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.following.appearance import likeness, together
from posegaussian.stages.following.follower import FARTHEST, SPEED, STILL, Encounter

MARGIN = 0.1
"""By how much better two people's looks must fit the other way round before they are exchanged."""
ALIKE = 0.75
"""Affinity of looks from which on somebody who comes back may be who went."""
ALONE = 0.5
"""The same where nobody else is seen from before to after: of one person who turns, or holds something before the body,
looks change by as much (the man of `desk`, a frame a second: 0.61 and more), those of two filmed people are alike by
0.42 at most (docs/measurements/mattes.md)."""
CLEARER = 0.03
"""By how much better than anybody else."""
BONES = 0.15
"""Median difference of bones, over their lengths, up to which two people may be one."""
BONES_ALONE = 0.25
"""The same where nobody else is seen: of the man of `desk`, whose table hides his hips, they differ by 0.15."""
MOST = 64
"""Pieces that are compared by their looks, the longest ones: comparing is quadratic."""


@dataclass(eq=False)
class Piece:
    """A person as they were followed without a doubt: between encounters, or from coming to going."""

    number: int
    """Of the follower."""
    frames: np.ndarray
    """[n] frames in which the person was seen, ascending."""
    start: np.ndarray
    """[D] where they were first."""
    end: np.ndarray
    """[D] and last."""
    size: float
    """Extent."""
    bones: np.ndarray
    """[B] lengths, 0 = unknown."""


def cuts_of(encounters: Sequence[Encounter], number: int) -> list[int]:
    """Frames at which a person's pieces end: those of their encounters' nearest approach."""
    return sorted({e.nearest for e in encounters if number in e.pair})


def pieces_of(frames: np.ndarray, cuts: Sequence[int]) -> list[np.ndarray]:
    """A person's frames [n] between cuts, one array more than there are cuts; a cut's own frame goes before it."""
    return np.split(frames, np.searchsorted(frames, np.asarray(cuts, dtype=np.int64), side="right"))


def exchanged(
    encounters: Sequence[Encounter], looks: Mapping[tuple[int, int], np.ndarray]
) -> list[tuple[int, int, int]]:
    """(frame, a, b): after that frame, the follower's a and b are each other; in order.

    looks: {(number, piece): histograms [2, B]}, pieces counted as by `pieces_of`.
    """
    who = {n: n for e in encounters for n in e.pair}
    known: dict[int, list[np.ndarray]] = {n: [looks[n, 0]] if (n, 0) in looks else [] for n in who}
    cuts = {n: cuts_of(encounters, n) for n in who}
    found = []
    for e in encounters:
        a, b = e.pair
        after = [looks.get((n, cuts[n].index(e.nearest) + 1)) for n in e.pair]
        before = [together(known[who[n]]) for n in e.pair]
        if all(x is not None for x in after):
            stay = [likeness(x, y) for x, y in zip(before, after, strict=True) if y is not None]
            turn = [likeness(x, y) for x, y in zip(before, after[::-1], strict=True) if y is not None]
            if None not in (*stay, *turn) and sum(filter(None, turn)) > sum(filter(None, stay)) + MARGIN:
                found.append((e.nearest, a, b))
                who[a], who[b] = who[b], who[a]
        for n, x in zip(e.pair, after, strict=True):
            if x is not None:
                known[who[n]].append(x)
    return found


def rejoined(pieces: Sequence[Piece], looks: Mapping[int, np.ndarray], times: np.ndarray, gap: float) -> dict[int, int]:
    """{number: the number whom they really are} of people who went and came back: the same looks and bones, and within
    reach in the time between. Where looks say nothing, only a gap of up to `gap` seconds is bridged; where nobody else
    is seen all the while, looks alike by `ALONE` and bones within `BONES_ALONE` suffice.

    times [F] seconds of all frames.
    """
    order = sorted(pieces, key=lambda p: (-len(p.frames), p.frames[0], p.number))[:MOST]
    found = [
        (fit, int(after.frames[0]), before.number, after.number)
        for before in order
        for after in order
        if before.frames[-1] < after.frames[0]
        and (fit := _fit(before, after, looks, float(times[after.frames[0]] - times[before.frames[-1]]), gap))
        and ((fit >= ALIKE and _bones_off(before, after) <= BONES) or _nobody_else(before, after, order))
    ]
    root = {p.number: p.number for p in pieces}
    spans = {p.number: [p] for p in pieces}
    for fit, _, a, b in sorted(found, key=lambda x: (-x[0], *x[1:])):
        first, second = root[a], root[b]
        if first == second or not _disjoint(spans, root, a, b) or _rivals(found, spans, root, a, b) > fit - CLEARER:
            continue
        keep, gone = min(first, second), max(first, second)
        spans[keep] += spans.pop(gone)
        root = {n: keep if r == gone else r for n, r in root.items()}
    return root


def _rivals(
    found: Sequence[tuple[float, int, int, int]],
    spans: Mapping[int, list[Piece]],
    root: Mapping[int, int],
    a: int,
    b: int,
) -> float:
    """How well a could go on as somebody seen together with b, or b have been somebody seen together with a."""
    of_a = [f for f, _, x, y in found if root[x] == root[a] and root[y] != root[b] and not _disjoint(spans, root, y, b)]
    of_b = [f for f, _, x, y in found if root[y] == root[b] and root[x] != root[a] and not _disjoint(spans, root, x, a)]
    return max([*of_a, *of_b], default=0.0)


def _fit(before: Piece, after: Piece, looks: Mapping[int, np.ndarray], passed: float, gap: float) -> float:
    """How well one piece goes on as another, 0..1; 0: not at all."""
    size = max(before.size, after.size, 1e-9)
    off = float(np.linalg.norm(after.start - before.end)) / size
    if off > STILL + SPEED * passed or _bones_off(before, after) > BONES_ALONE:
        return 0.0
    alike = (
        likeness(looks[before.number], looks[after.number]) if {before.number, after.number} <= looks.keys() else None
    )
    if alike is None:
        return 1.0 if passed <= gap and off <= min(STILL + SPEED * passed, FARTHEST) else 0.0
    return alike if alike >= ALONE else 0.0


def _nobody_else(before: Piece, after: Piece, pieces: Sequence[Piece]) -> bool:
    """Whether nobody who is seen in as many frames as the shorter of two pieces is there from the beginning of the
    first to the end of the second."""
    own, first, last = {before.number, after.number}, before.frames[0], after.frames[-1]
    least = min(len(before.frames), len(after.frames))
    there = [p for p in pieces if p.frames[0] <= last and p.frames[-1] >= first and len(p.frames) >= least]
    return own.issuperset(p.number for p in there)


def _bones_off(before: Piece, after: Piece) -> float:
    """Median difference of bones, over their lengths; 0 where the two have none in common."""
    a, b = before.bones, after.bones
    both = (a > 0) & (b > 0)
    return float(np.median(np.abs(a - b)[both] / np.maximum(a, b)[both])) if both.any() else 0.0


def _disjoint(spans: Mapping[int, list[Piece]], root: Mapping[int, int], a: int, b: int) -> bool:
    """Whether nobody is in two places at once if a and b are one."""
    first, second = spans[root[a]], spans[root[b]]
    return all(p.frames[-1] < q.frames[0] or q.frames[-1] < p.frames[0] for p in first for q in second)
