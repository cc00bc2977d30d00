"""Several frames' evidence bridges an occlusion: joints that a frame cannot triangulate, from the frames around it.

A frame's result is made from the frames within `reach` of it and nothing else, each time anew; there is no state that
runs along. First what cannot be is rejected: bones of the wrong length, joints that jump away and back. Then, from hips
and shoulders outwards, a missing joint goes where it hangs on its parent: the offset between the two is interpolated
over the frames before and after, by a cubic where two are known on each side, and brought to the length the bone has
there. A detection of a single view, which says where the joint is but not how deep, moves it onto its ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.points import NEAR, rays
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

FEWEST = 5
"""Frames a bone must be known in before its length is judged."""
LENGTH = 0.3
"""Share of a bone's median length that it may be off by,"""
SPREAD = 5.0
"""or this many standard deviations (from the median deviation),"""
SLACK = 0.06
"""or this many metres, whichever is most: short bones of the face are known to centimetres only."""
JUMP = 1.0
"""Metres about the body's middle from one frame to the next: 30 m/s at 30 frames a second, faster than any throw."""
DRIFT = 0.02
"""Metres a frame by which an interpolated joint is uncertain, against"""
BONE = 0.02
"""metres by which a bone's length is; they decide how deep a joint lies on a single view's ray."""
ASIDE = 0.1
"""Metres, and half as much again for every frame to the nearest known one, that a single view's ray may pass the
expected place by."""
_HIPS = ("LHip", "RHip")


@dataclass(frozen=True, eq=False)
class Bones:
    """How joints hang on each other."""

    ends: np.ndarray
    """[B, 2] joints at the ends of every bone."""
    order: tuple[int, ...]
    """Joints from the hips outwards; a parent comes before its children."""
    parents: tuple[int, ...]
    """[J] the joint that each hangs on, -1 for none."""

    @classmethod
    def of(cls, set_id: str) -> Bones:
        """Bones of a joint set; SourceError for an unknown one."""
        chosen = joint_set(set_id)
        count = len(chosen)
        parents = [-1] * count
        order = [chosen.names.index(n) for n in _HIPS if n in chosen.names]
        for i in range(count):
            if i >= len(order):  # what no limb links to the hips stands alone
                order.append(next(j for j in range(count) if j not in order))
            for a, b in chosen.limbs:
                for here, there in ((a, b), (b, a)):
                    if here == order[i] and there not in order:
                        parents[there] = here
                        order.append(there)
        return cls(np.array(chosen.limbs, dtype=np.int64).reshape(-1, 2), tuple(order), tuple(parents))


def bridge(
    rig: Rig,
    joints: np.ndarray,
    points: np.ndarray,
    at: int,
    reach: int,
    bones: Bones,
    min_score: float,
    run: slice = slice(None),
) -> np.ndarray:
    """Points [J, 4] (x, y, z, score) of frame `at`, world metres, 0 score = unknown, from those of the frames around
    it.

    points [F, J, 4] as triangulated; joints [V, J, 3] the detections of frame `at` in pixels of `rig` (no lens); only
    frames within `reach` are looked at, and those that are not in the `run` of frames that follow each other in time
    around this one say how long bones are and nothing else. A joint known here and not rejected is returned bit by bit.
    A frame in which nothing is known stays so: nobody may be there. A bridged joint's score falls from that of the
    frames it comes from, by 1 / (reach + 1) for every frame to the nearest of them; it is halved where there is only a
    before or only an after, which takes a view's ray to be believed.
    """
    first = max(0, at - reach)
    window, here = points[first : at + reach + 1], at - first
    linked = np.zeros(len(points), dtype=bool)
    linked[run] = True
    linked = linked[first : at + reach + 1]
    sound = ~rejected(window, bones, linked) & (window[..., 3] > 0) & linked[:, None]
    out = np.where(sound[here][:, None], points[at], 0.0)
    for j in bones.order if sound[here].any() else ():
        if not sound[here, j]:
            out[j] = _joint(rig, joints[:, j], _expect(window, sound, here, reach, j, bones.parents[j], out), min_score)
    return out


def rejected(points: np.ndarray, bones: Bones, linked: np.ndarray | None = None) -> np.ndarray:
    """[F, J] known joints of [F, J, 4] that cannot be: at the end of bones of another length, or that jump away and
    back among frames that follow each other, `linked` [F] bool; None: all do.

    Of a frame's impossible bones, the joint goes first that most of them meet at; of equals, the one that they are the
    greater share of and that fewer views agree on, by share less score.
    """
    known = points[..., 3] > 0
    follow = slice(None) if linked is None else linked
    bad, ends = np.zeros(known.shape, dtype=bool), bones.ends
    bad[follow] = _jumps(points[follow], known[follow])
    both = known[:, ends[:, 0]] & known[:, ends[:, 1]]
    judged = both & (both.sum(axis=0) >= FEWEST)
    lengths = np.linalg.norm(points[:, ends[:, 0], :3] - points[:, ends[:, 1], :3], axis=-1)
    median = _median(lengths, judged)
    off = np.where(judged, np.abs(lengths - median), 0.0)
    bound = np.maximum(np.maximum(LENGTH * median, SPREAD * 1.4826 * _median(off, judged)), SLACK)
    for f in np.flatnonzero((off > bound).any(axis=1)):
        wrong = (off[f] > bound) & ~bad[f, ends].any(axis=-1)
        bad[f] |= _blamed(wrong, judged[f], ends, points[f, :, 3])
    return bad


def _median(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """[B] median over frames of values [F, B], of those that count [F, B]; 0 where none does."""
    none = ~counts.any(axis=0)
    return np.nanmedian(np.where(none, 0.0, np.where(counts, values, np.nan)), axis=0)


def _blamed(wrong: np.ndarray, judged: np.ndarray, ends: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """[J] joints of scores [J] to reject so that no wrong bone [B] is left."""
    out, count = np.zeros(len(scores), dtype=bool), len(scores)
    total = np.maximum(np.bincount(ends[judged].ravel(), minlength=count), 1)
    while wrong.any():
        meet = np.bincount(ends[wrong].ravel(), minlength=count)
        worst = int(np.where(meet == meet.max(), meet / total - scores, -np.inf).argmax())
        out[worst] = True
        wrong = wrong & (ends != worst).all(axis=-1)
    return out


def _jumps(points: np.ndarray, known: np.ndarray) -> np.ndarray:
    """[F, J] joints farther than `JUMP` from where they are in both neighbouring frames, about the body's middle."""
    out = np.zeros(known.shape, dtype=bool)
    for f in range(1, len(points) - 1):
        in_all = known[f - 1 : f + 2].all(axis=0)
        if in_all.any():
            place = points[f - 1 : f + 2, in_all, :3]
            place = place - np.median(place, axis=1, keepdims=True)
            out[f, in_all] = (np.linalg.norm(place[[0, 2]] - place[1], axis=-1) > JUMP).all(axis=0)
    return out


@dataclass(frozen=True, eq=False)
class _Expected:
    """Where a missing joint should be."""

    place: np.ndarray
    """[3] world metres."""
    score: float
    """Of the frames it comes from, lowered by how far off they are."""
    frames: int
    """To the nearest of them."""
    between: bool
    """Whether there is one before and one after."""
    parent: np.ndarray | None
    """[3] the joint it hangs on, where that is known,"""
    length: float
    """and how far off it, metres."""


def _joint(rig: Rig, seen: np.ndarray, expected: _Expected | None, min_score: float) -> np.ndarray:
    """[4] a joint from where it is expected and from detections [V, 3], all zeros where that is not enough."""
    if expected is None:
        return np.zeros(4)
    place, passes = _on_ray(rig, seen, expected, min_score)
    if not (passes or expected.between):
        return np.zeros(4)
    return np.array([*place, expected.score if expected.between else expected.score / 2])


def _expect(
    window: np.ndarray, sound: np.ndarray, here: int, reach: int, j: int, parent: int, out: np.ndarray
) -> _Expected | None:
    """From the two nearest frames on either side, of those where the parent is known, too, if it is known here."""
    hangs = parent >= 0 and out[parent, 3] > 0 and bool((sound[:, j] & sound[:, parent]).any())
    known = np.flatnonzero(sound[:, j] & sound[:, parent] if hangs else sound[:, j])
    before, after = known[known < here][-2:], known[known > here][:2]
    nearest = [*before[-1:], *after[:1]]
    if not nearest:
        return None
    used = np.concatenate([before, after]) if len(before) and len(after) else np.array(nearest)
    base = window[:, parent, :3] if hangs else np.zeros((len(window), 3))
    offset = _lagrange(used - here) @ (window[used, j, :3] - base[used])
    frames = min(abs(int(n) - here) for n in nearest)
    score = min(float(window[n, j, 3]) for n in nearest) * (1 - frames / (reach + 1))
    if not hangs:
        return _Expected(offset, score, frames, len(nearest) == 2, None, 0.0)
    ends = np.array(nearest)
    length = float(_lagrange(ends - here) @ np.linalg.norm(window[ends, j, :3] - base[ends], axis=-1))
    offset = offset * (length / max(float(np.linalg.norm(offset)), 1e-9))
    return _Expected(out[parent, :3] + offset, score, frames, len(nearest) == 2, out[parent, :3], length)


def _lagrange(times: np.ndarray) -> np.ndarray:
    """[n] weights of values at `times`, none of them 0, whose sum is the interpolating polynomial's value at 0."""
    t = times.astype(np.float64)
    apart = t[:, None] - t
    np.fill_diagonal(apart, 1.0)
    ratio = np.where(np.eye(len(t), dtype=bool), 1.0, -t / apart)
    return ratio.prod(axis=1)


def _on_ray(rig: Rig, seen: np.ndarray, expected: _Expected, min_score: float) -> tuple[np.ndarray, bool]:
    """The expected place moved onto the nearest view's ray through its detection, and whether one passes near enough.

    Along the ray it goes where deviations from the expected place and from the bone's length together are least likely.
    """
    views = np.flatnonzero(seen[:, 2] >= min_score)
    if not len(views):
        return expected.place, False
    directions, centres = rays(rig, views, seen[views, None, :2])[1][:, 0], rig.centres[views]
    along = ((expected.place - centres) * directions).sum(-1)
    aside = np.linalg.norm(centres + along[:, None] * directions - expected.place, axis=-1)
    best = int(np.where(along > NEAR, aside, np.inf).argmin())
    if along[best] <= NEAR or aside[best] > ASIDE * (1 + expected.frames / 2):
        return expected.place, False
    foot, direction = centres[best] + along[best] * directions[best], directions[best]
    if expected.parent is None:
        return foot, True
    depth, drift = 0.0, DRIFT * expected.frames
    for _ in range(10):  # Gauss-Newton on (depth / drift)^2 + ((|X - parent| - length) / BONE)^2
        arm = foot + depth * direction - expected.parent
        reached = max(float(np.linalg.norm(arm)), 1e-9)
        slope = float(arm @ direction) / reached / BONE
        depth -= (depth / drift**2 + (reached - expected.length) / BONE * slope) / (1 / drift**2 + slope**2)
    return foot + depth * direction, True
