"""Which camera is out of step, by what it shows in frames beside those that are compared.

Somebody who moves, seen at another moment, contradicts what the other cameras show, much as somebody whom a camera sees
that is turned. Where one camera alone does, its own frames around are asked: the one that fits the others tells by how
many it is late.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.triangulation import Tracks
from posegaussian.stages.imaging.small_turns import SIDE
from posegaussian.stages.silhouettes.coherence import FEWEST, REST, Outlined, contradiction
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.stages.survey.standing.by_joints import (
    APART,
    AS_WELL,
    CLEAR,
    CURED,
    EXACT,
    FEWEST_JOINTS,
    NEARER,
    PART,
    beside,
    meeting_points,
    scatter,
    turned_back,
)
from posegaussian.storage.model.cameras import Rig

AROUND = 4
"""Frames up to which those of a camera are asked, either way; what fits best of those at the ends may not be what fits,
and tells nothing."""
FEWEST_FRAMES, OF_A_FRAME = 3, 3
"""Frames in which joints must lie nearer at that moment, each by itself, and joints of a frame that tell: of one or two
alone it is the detector that errs, as in `desk`, whose cameras are in step."""


@dataclass(frozen=True, eq=False)
class OutOfStep:
    """A camera that shows another moment."""

    camera: int
    """Which."""
    frames: float
    """By how many it is late."""
    apart: float
    """Px of the rig's largest pictures by which its joints lie beside those of the others, median."""
    joints: np.ndarray
    """[F, J, 3] (u, v, score) as it sees them at the moments of the others, px of the rig."""


def late_by_silhouettes(
    rig: Rig, masks: Mapping[int, Mapping[int, np.ndarray]], wrong: int, around: Callable[[int], np.ndarray | None]
) -> int:
    """Frames by which the only wrong camera is late, by the masks [h, w] uint8 of each compared frame by view index; 0
    where none of its own around them makes it as coherent with the others as these are.

    around: its mask of a frame, None where it has none.
    """
    views = sorted(set.intersection(*(set(Outlined.of(rig, of_frame).rims) for of_frame in masks.values())))

    def left(by: int) -> float:
        shown = {n: around(n + by) for n in masks}
        frames = [Outlined.of(rig, {**masks[n], wrong: mask}) for n, mask in shown.items() if mask is not None]
        whole = len(frames) == len(masks) and all(wrong in f.rims for f in frames)
        return contradiction(rig, frames, views) if whole else np.inf

    of_moments = {by: left(by) for by in range(-AROUND, AROUND + 1)}
    best = min(of_moments, key=lambda by: (of_moments[by], abs(by)))
    return best if abs(best) < AROUND and of_moments[best] <= REST * of_moments[0] else 0


def late_by_joints(
    rig: Rig, joints: np.ndarray, numbers: np.ndarray, around: Callable[[int, np.ndarray], np.ndarray]
) -> OutOfStep | None:
    """The only one of S cameras that shows another moment than the others, by the joints [S, F, J, 3] (u, v, score) of
    each one's largest person in frames `numbers` [F], px of the rig; None where none or several do, or where a turn
    explains its joints better.

    around: those [n, J, 3] that a camera sees in frames [n] beside these, score 0 where unknown.
    """
    if len(rig) < FEWEST:
        return None
    of_all, views = joints.reshape(len(rig), -1, 3), range(len(rig))
    tracks = Tracks.of(rig, np.arange(len(rig)), of_all, SCORE)
    rest = [scatter(rig, tracks, set(views) - {v}) for v in views]
    suspect, second = (int(v) for v in np.argsort(rest, kind="stable")[:2])
    if not np.isfinite(rest[suspect]) or rest[second] < (1 + CLEAR / len(rig)) * rest[suspect]:
        return None
    right, camera = [v for v in views if v != suspect], rig.subset([suspect])
    points = meeting_points(tracks, right).reshape(*joints.shape[1:3], 3)
    known = ((tracks.weights[right] > 0).sum(axis=0) >= 2).reshape(joints.shape[1:3])
    apart = beside(camera, joints[suspect], points, known)
    if not APART <= apart < np.inf:
        return None
    turned = turned_back(rig, of_all, tracks, frozenset({suspect}))
    moments = _moments(joints[suspect], numbers, lambda asked: around(suspect, asked))
    compared = {by: _compared(camera, moments, by, points, known) for by in moments}
    best = _best({by: left / now for by, (left, now) in compared.items() if np.isfinite(left) and now > 0})
    left, now = compared[best]
    if turned is None or not 0 < abs(best) < AROUND or now < max(APART, NEARER * left):
        return None
    if left > min(CURED * max(EXACT, rest[suspect]), turned.after[suspect]):
        return None
    return OutOfStep(suspect, best, apart * float(rig.size.max()) / SIDE, moments[best])


def _compared(
    camera: Rig, moments: Mapping[float, np.ndarray], by: float, points: np.ndarray, known: np.ndarray
) -> tuple[float, float]:
    """Px of a picture of `SIDE` px by which joints [F, J, 3] that a camera sees so many frames later lie beside where
    the others leave them [F, J, 3], and those of now, of the same joints in the same frames: what is known of one of
    them alone, a frame in which a stranger was found, says nothing.

    Infinite of too few, or where fewer than `FEWEST_FRAMES` frames by themselves say so. Who is seen late lies farther
    away at the opposite moment than now; where a detector errs, now, both are nearer.
    """
    now, then, opposite = (moments[m] for m in (0, by, -by))
    both = known & (now[..., 2] >= SCORE) & (then[..., 2] >= SCORE)
    if both.sum() < FEWEST_JOINTS:
        return np.inf, np.inf
    all_three = both & (opposite[..., 2] >= SCORE)
    told = np.flatnonzero(all_three.sum(axis=1) >= OF_A_FRAME)
    of_frames = np.array(
        [[beside(camera, at[f], points[f], all_three[f]) for at in (then, now, opposite)] for f in told]
    ).reshape(-1, 3)
    left, apart, farther = of_frames[of_frames[:, 1] >= APART].T
    says = (apart >= NEARER * left) & (farther >= AS_WELL * apart)
    if by and (says.sum() < FEWEST_FRAMES or not says.all()):
        return np.inf, np.inf
    return beside(camera, then, points, both), beside(camera, now, points, both)


def _best(left: Mapping[float, float]) -> float:
    """Frames later at which least is left, as a share of what is now; half frames only where these fit clearly better
    than whole ones, as a detector errs by less on the mean of two frames than in one. 0 of nothing."""
    ordered = sorted(left, key=lambda by: (left[by], abs(by)))
    best, whole = (next((by for by in ordered if by % 1 in parts), 0.0) for parts in ((0, PART), (0,)))
    return best if AS_WELL * left.get(best, 0.0) < left.get(whole, np.inf) else whole


def _moments(
    joints: np.ndarray, numbers: np.ndarray, around: Callable[[np.ndarray], np.ndarray]
) -> Mapping[float, np.ndarray]:
    """By frames later, the joints [F, J, 3] that a camera sees so much after frames `numbers` [F], of those between the
    first and the last of them: in whole frames, and amid every two of them."""
    moments = numbers + np.arange(-AROUND, AROUND + 1)[:, None]
    inside = (moments >= numbers[0]) & (moments <= numbers[-1])
    asked = np.setdiff1d(moments[inside], numbers)
    known = dict(zip([*numbers, *asked], [*joints, *(around(asked) if len(asked) else ())], strict=True))
    nothing = np.zeros_like(joints[0])
    shown = [np.stack([known.get(n, nothing) for n in of_frames]) for of_frames in moments]
    whole = dict(zip(range(-AROUND, AROUND + 1), shown, strict=True))
    return whole | {by + PART: _amid(whole[by], whole[by + 1]) for by in range(-AROUND, AROUND)}


def _amid(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """[..., 3] joints half way between two frames, known where both are."""
    score = np.minimum(before[..., 2], after[..., 2])
    return np.concatenate([(before + after)[..., :2] / 2, score[..., None]], axis=-1)
