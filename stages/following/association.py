"""The people of one frame: which detections of different views are one person.

Every two detections of different views, one of them also mirrored, are triangulated joint by joint. Of these
hypotheses the one that most joints of most views agree with is the first person; those detections are taken away, and
the next person is looked for among the rest. Bounds are shares of a body, not of a picture, so that two people side by
side stay two however small they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.following.nearness import FEWEST, FLIPS, apart, extent
from posegaussian.stages.geometry.points import NEAR, project
from posegaussian.stages.geometry.triangulation import Tracks, hypotheses, pairs_of, triangulate
from posegaussian.storage.model.cameras import Rig

SCORE = 0.2
"""Least score of a joint that counts."""
RESIDUAL = 0.02
"""Reprojection error above which a joint does not agree, a share as `unit_of` has it: a tenth of a small person."""
AGREEING = 0.2
"""Share of a detection's score that must agree with a hypothesis."""
DOUBLED = 0.1
"""Distance of two people in space over their extent below which only one can stand there."""
SAME = 0.06
"""Median distance of a detection from the person in space, over its extent, up to which it is that person: on people
who were filmed it is at most 0.03, and of somebody who hides another in a picture 0.055 and more."""
SIZES = (0.67, 1.25)
"""Extent of a detection over that of the person in space seen there, between which it may be that person: who hides
another is nearer, and larger."""

TOUCHING, SHARED = 0.03, 0.4
"""Extents within which two detections' joints are the same, and the share of such joints that makes a detection of
somebody else doubtful."""


@dataclass(frozen=True, eq=False)
class Seen:
    """One person of one frame."""

    members: np.ndarray
    """[V] index among the view's people; -1 where the view does not see the person."""
    joints: np.ndarray
    """[17, D + 1]: in space (x, y, z, score), world metres; of a single view (u, v, score) px."""


def associate(rig: Rig, people: Sequence[np.ndarray]) -> list[Seen]:
    """People of one frame, V arrays [P_v, 17, 3] COCO-17 in pixels of `rig`, as those whom two views or more agree on;
    the best seen first. The order of people within a view does not matter."""
    orders = [canonical(p) for p in people]
    views = np.repeat(np.arange(len(people)), [len(o) for o in orders])
    if len(np.unique(views)) < 2:
        return []
    own = np.concatenate(orders)
    joints = np.concatenate([p[o] for p, o in zip(people, orders, strict=True)])
    gain, mirrored, pairs = _agreement(rig, views, joints)
    free, found = np.ones(len(views), dtype=bool), list[Seen]()
    while len(found) < len(views):
        open_gain = np.where(free, gain, 0.0)
        best = np.stack([np.where(views == v, open_gain, 0.0).max(axis=1) for v in range(len(people))], axis=-1)
        total = np.where((open_gain[np.arange(len(pairs))[:, None], pairs] > 0).all(axis=1), best.sum(-1), 0.0)
        winner = int(total.argmax()) if len(total) else 0
        if not len(total) or total[winner] <= 0:
            break
        members = [int(np.where(views == v, open_gain[winner], 0.0).argmax()) for v in np.flatnonzero(best[winner] > 0)]
        turned = np.where(mirrored[winner][:, None, None], joints[:, FLIPS], joints)
        person = _person(rig, views, turned, members)
        if person is None or any(_doubled(person[1], other.joints) for other in found):
            gain[winner] = 0.0
            continue
        kept, space = person
        free[kept] = False
        for t in kept:
            others = np.flatnonzero(free & (views == views[t]))
            free[others[[_shares(joints[o], joints[t]) for o in others]]] = False
        index = np.full(len(people), -1)
        index[views[kept]] = own[kept]
        found.append(Seen(index, space))
    return found


def canonical(people: np.ndarray) -> np.ndarray:
    """[P] an order of a view's people [P, J, 3] that depends on themselves alone; those without joints left out."""
    if not len(people):
        return np.zeros(0, np.int64)
    order = np.lexsort(people.reshape(len(people), -1).T[::-1])
    return np.asarray(order[((people[..., 2] >= SCORE).sum(axis=1) >= FEWEST)[order]])


def _agreement(rig: Rig, views: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[P, T] by how much each detection agrees with each hypothesis, 0 where it does not; whether it does so mirrored;
    and the pairs [P, 2]."""
    count = len(views)
    both = np.concatenate([joints, joints[:, FLIPS]])
    tracks = Tracks.of(rig, np.concatenate([views, views]), both, SCORE)
    plain = pairs_of(views)
    pairs = np.concatenate([plain, plain + np.array([0, count])])
    _, agreement = hypotheses(rig, tracks, pairs, RESIDUAL)
    total = agreement.sum(axis=1)
    enough = ((agreement > 0).sum(axis=1) >= FEWEST) & (total >= AGREEING * tracks.weights.sum(axis=1))
    gain = np.where(enough, total, 0.0)
    own_way, mirrored = gain[:, :count], gain[:, count:]
    return np.maximum(own_way, mirrored), mirrored > own_way, np.concatenate([plain, plain])


def _person(
    rig: Rig, views: np.ndarray, joints: np.ndarray, members: list[int]
) -> tuple[np.ndarray, np.ndarray] | None:
    """(detections that are the person, the person in space [17, 4]) of a hypothesis' members, joints turned as it has
    them; None where it is none."""
    while len(members) >= 2:
        seen = np.zeros((len(rig), *joints.shape[1:]))
        seen[views[members]] = joints[members]
        space = triangulate(rig, seen, SCORE, RESIDUAL)
        if (space[:, 3] > 0).sum() < FEWEST:
            return None
        off = np.array([distance(rig, int(views[t]), space, joints[t]) for t in members])
        if (off <= SAME).all():
            return np.array(members), space
        members = [t for i, t in enumerate(members) if i != int(off.argmax())]
    return None


def distance(rig: Rig, view: int, space: np.ndarray, joints: np.ndarray) -> float:
    """How far a detection [17, 3] of a view is from a person in space [17, 4], over the detection's extent there;
    infinite where it is too small or too large to be that person."""
    pixels, depth = project(rig, space[:, :3])
    known = (space[:, 3] > 0) & (depth[:, view] > NEAR)
    there = np.concatenate([pixels[:, view], known[:, None]], axis=-1)
    believed = np.where(joints[:, 2:] >= SCORE, joints, 0.0)
    size = max(extent(believed), extent(there))
    both = (there[:, -1:] > 0) & (believed[:, -1:] > 0)
    expected = extent(np.where(both, there, 0.0))
    if size <= 0 or expected <= 0 or not SIZES[0] <= extent(np.where(both, believed, 0.0)) / expected <= SIZES[1]:
        return np.inf
    return apart(there, believed) / size


def _shares(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether a detection takes so many joints of another one in the same picture that it is no other person: where
    people hide each other, a detector also gives the arms of one with the legs of the other."""
    both = (a[:, 2] >= SCORE) & (b[:, 2] >= SCORE)
    near = np.minimum(*(np.linalg.norm((x - b)[:, :2], axis=1) for x in (a, a[FLIPS]))) < TOUCHING * extent(b)
    return bool(near[both].mean() >= SHARED) if both.any() else False


def _doubled(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two people in space stand where only one can: two detections of the same person in one picture."""
    return apart(a, b) < DOUBLED * max(extent(a), extent(b))
