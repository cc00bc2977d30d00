"""Left and right exchanged by a detector, in some views or in some frames: found, and put back.

Detectors take a back for a front and name the whole body the wrong way round, or only the legs of a person seen from
the side. Arms and legs are therefore judged each on its own, and the head follows where both turn.

Within a frame, views are compared: of each part, a detection and its mirror image are two candidates of one view, and
the point hypothesis (see `triangulate`) wins that the best candidates of all views agree with. That settles which views
name the part alike, but not who is right. Frames are compared to know that: the part's 3D joints about their middle go
on from frame to frame either as they are or exchanged, and all views of all frames within reach, brought to the same
side by these links, vote. Where the vote is even, or a link or a view says nothing clearly, nothing is changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.triangulation import Tracks, hypotheses, pairs_of, residuals, triangulate
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

MARGIN = 0.25
"""Share of a part's score by which a view must agree better with the mirror image before it is exchanged."""
DOUBTFUL = 0.5
"""A part that agrees with the triangulated joints by a smaller share of its score makes a frame worth a closer look."""
CLEARLY = 0.6
"""A part goes on from one frame to another in the way that costs less than this share of the other way."""
LEAST_APART = 0.03
"""Metres, mean over joints, by which the two ways must differ: a hand beside the other one has no side."""
ARMS, LEGS, HEAD = range(3)
_LEGS = ("Hip", "Knee", "Ankle", "Heel", "Toe", "Foot")
_ARMS = ("Shoulder", "Elbow", "Wrist", "Hand", "Palm", "Finger", "Thumb", "Index", "Pinky", "Collar", "Clavicle")


@dataclass(frozen=True, eq=False)
class Sides:
    """The two-sided joints of a joint set."""

    flips: np.ndarray
    """[J] index of each joint's mirror image."""
    parts: np.ndarray
    """[3, J] which joints belong to the arms, the legs and the head; a joint of the midline to none."""

    @classmethod
    def of(cls, set_id: str) -> Sides:
        """Sides of a joint set; SourceError for an unknown one."""
        chosen = joint_set(set_id)
        flips = np.array(chosen.flips)
        legs, arms = (
            np.array([any(word in name for word in words) for name in chosen.names]) for words in (_LEGS, _ARMS)
        )
        two = flips != np.arange(len(flips))
        return cls(flips, np.stack([two & arms & ~legs, two & legs, two & ~arms & ~legs]))

    def exchange(self, joints: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Joints [..., J, C] with left and right exchanged in the parts named by [..., 3] bool."""
        turned = (parts[..., None] & self.parts).any(axis=-2)
        return np.where(turned[..., None], joints[..., self.flips, :], joints)


@dataclass(frozen=True, eq=False)
class Sighting:
    """One frame's detections of the subject,
    and what has to be exchanged so that its views name left and right alike."""

    joints: np.ndarray
    """[V, J, 3] (u, v, score) px as detected."""
    exchanged: np.ndarray
    """[V, 3] bool: the parts to exchange so that all views agree, one of the two ways."""
    points: np.ndarray
    """[J, 4] (x, y, z, score) of the joints so exchanged, world metres."""
    gain: np.ndarray
    """[V, 3] by how much better than the part as detected its mirror image agrees with the points."""
    weights: np.ndarray
    """[V, 3] the largest possible gain: the part's scores; 0 where a view does not see it."""

    @property
    def votes(self) -> np.ndarray:
        """[3] views that clearly fit a part as detected, less those that clearly fit its mirror image; 0: even."""
        clear = MARGIN * self.weights
        return (self.gain < -clear).sum(axis=0) - (self.gain > clear).sum(axis=0)

    def settled(self, turn: np.ndarray, even: np.ndarray) -> np.ndarray:
        """[V, 3] parts to exchange if in those of `turn` [3] it is the other views that are wrong; none in those
        that are `even` [3]."""
        out = np.where(turn, self.gain < 0, self.exchanged) & ~even
        opposes = np.where(turn[HEAD], self.gain, -self.gain)[:, HEAD] >= MARGIN * self.weights[:, HEAD]
        out[:, HEAD] = out[:, ARMS] & out[:, LEGS] & ~opposes
        return out


def between_views(rig: Rig, joints: np.ndarray, sides: Sides, min_score: float, max_residual: float) -> Sighting:
    """Compare the views of one frame, joints [V, J, 3] in pixels of `rig` (no lens), with each other."""
    points = triangulate(rig, joints, min_score, max_residual)
    own, mirrored, weights = _evidence(rig, joints, points, sides, min_score, max_residual)
    exchanged = np.zeros((len(rig), 3), dtype=bool)
    if len(rig) < 2 or (own >= DOUBTFUL * weights)[:, :HEAD].all():
        return Sighting(joints, exchanged, points, mirrored - own, weights)
    exchanged = _relative(rig, joints, sides, min_score, max_residual)
    for _ in range(2):
        points = triangulate(rig, sides.exchange(joints, exchanged), min_score, max_residual)
        own, mirrored, weights = _evidence(rig, joints, points, sides, min_score, max_residual)
        gain = mirrored - own
        exchanged = gain > MARGIN * weights
        exchanged[:, HEAD] = exchanged[:, ARMS] & exchanged[:, LEGS] & (gain[:, HEAD] > -MARGIN * weights[:, HEAD])
    return Sighting(
        joints, exchanged, triangulate(rig, sides.exchange(joints, exchanged), min_score, max_residual), gain, weights
    )


def _evidence(
    rig: Rig, joints: np.ndarray, points: np.ndarray, sides: Sides, min_score: float, max_residual: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Agreement [V, 3] of every view's parts with points [J, 4], as detected and mirrored,
    and its largest possible value."""
    views = np.arange(len(rig))
    parts = sides.parts.T.astype(np.float64)
    out = []
    for candidate in (joints, joints[:, sides.flips]):
        tracks = Tracks.of(rig, views, candidate, min_score)
        share = np.minimum(residuals(rig, tracks, points[:, :3]) / tracks.unit / max_residual, 1.0)
        out.append((np.where(points[:, 3:] > 0, tracks.weights.T * (1.0 - share**2), 0.0).T) @ parts)
    weights = np.where(joints[..., 2] >= min_score, joints[..., 2], 0.0)
    return out[0], out[1], weights @ parts


def _relative(rig: Rig, joints: np.ndarray, sides: Sides, min_score: float, max_residual: float) -> np.ndarray:
    """[V, 3] a first guess of the parts to exchange so that views agree, in fewer than half of them."""
    count = len(rig)
    views = np.concatenate([np.arange(count)] * 2)
    tracks = Tracks.of(rig, views, np.concatenate([joints, joints[:, sides.flips]]), min_score)
    _, agreement = hypotheses(rig, tracks, pairs_of(views), max_residual)
    found = np.zeros((count, 3), dtype=bool)
    for part in (ARMS, LEGS):
        of_view = agreement[:, sides.parts[part]].sum(axis=1).reshape(-1, 2, count)  # [P, as detected or mirrored, V]
        winner = of_view[int(of_view.max(axis=1).sum(axis=-1).argmax())]
        found[:, part] = winner[1] > winner[0]
        told = winner[1] != winner[0]
        if 2 * int(found[told, part].sum()) > int(told.sum()):
            found[:, part] = winner[1] < winner[0]
    found[:, HEAD] = found[:, ARMS] & found[:, LEGS]
    return found


def between_frames(sightings: Sequence[Sighting], at: int, reach: int, sides: Sides) -> np.ndarray:
    """[V, 3] the parts to exchange in frame `at`, judged by the frames up to `reach` before and after it.

    A part's votes of all frames that are linked to this one are summed, each brought to this frame's side. If the sum
    speaks for the exchange, views that were to stay are exchanged and the others stay; if it is even, all stay as
    detected.
    """
    here = sightings[at]
    others = np.array([_votes(sightings, at, reach, sides, part) for part in range(3)])
    total = here.votes + others
    turn, even = total < 0, total == 0
    turn[HEAD], even[HEAD] = turn[ARMS] and turn[LEGS] and others[HEAD] <= 0, False  # it follows
    return here.settled(turn, even)


def _votes(sightings: Sequence[Sighting], at: int, reach: int, sides: Sides, part: int) -> int:
    """Votes of the other frames within reach on one part of frame `at`, as far as links go on both sides."""
    total = 0
    for step in (-1, 1):
        last, same = at, 1
        for other in range(at + step, at + step * (reach + 1), step):
            if not 0 <= other < len(sightings):
                break
            link = _link(sightings[last].points, sightings[other].points, sides, part)
            if link is None:
                continue
            if link == 0:
                break
            last, same = other, same * link
            total += same * int(sightings[other].votes[part])
    return total


def _link(a: np.ndarray, b: np.ndarray, sides: Sides, part: int) -> int | None:
    """How a part of points [J, 4] goes on in another frame's: 1 as it is, -1 exchanged, 0 unclear;
    None where it is unknown."""
    known = (a[:, 3] > 0) & (b[:, 3] > 0)
    joints = np.flatnonzero(sides.parts[part] & known & known[sides.flips])
    if not len(joints):
        return None
    # both sides of every pair are among the joints, so that their middle does not depend on which is which
    before, after, mirrored = a[joints, :3], b[joints, :3], b[sides.flips[joints], :3]
    shift = after.mean(axis=0) - before.mean(axis=0)
    same, other = (float(np.linalg.norm(p - before - shift, axis=-1).mean()) for p in (after, mirrored))
    if abs(same - other) < LEAST_APART or min(same, other) > CLEARLY * max(same, other):
        return 0
    return 1 if same < other else -1


def mended(
    rig: Rig, sightings: Sequence[Sighting], at: int, reach: int, sides: Sides, min_score: float, max_residual: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame `at` after both comparisons: joints [V, J, 3], their points [J, 4], and [V, 3] which parts were exchanged.

    Where nothing was, the joints are those detected and the points those of `triangulate`, bit by bit.
    """
    here, exchanged = sightings[at], between_frames(sightings, at, reach, sides)
    joints = sides.exchange(here.joints, exchanged) if exchanged.any() else here.joints
    points = here.points if (exchanged == here.exchanged).all() else triangulate(rig, joints, min_score, max_residual)
    return joints, points, exchanged
