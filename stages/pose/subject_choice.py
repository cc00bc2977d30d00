"""Which of several detected people is the one subject: the combination the rig agrees on, nearest to where it looks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.stages.geometry.points import focus
from posegaussian.stages.geometry.triangulation import Tracks, hypotheses, pairs_of
from posegaussian.storage.model.cameras import Rig


def subject(rig: Rig, people: Sequence[np.ndarray], min_score: float, max_residual: float) -> np.ndarray:
    """People of one frame, V arrays [P_v, J, 3] in pixels of `rig` -> joints [V, J, 3] of the one subject, zeros where
    unseen.

    Every two detections of different views are triangulated joint by joint; every view answers with the person that
    agrees best with the result, and the pair with the greatest agreement over all views wins. Agreement is weighted by
    1 / (1 + (d / r)^2), d the distance of the skeleton from the point all cameras look at and r the cameras' mean
    distance from it, so that of two people seen equally well the one in the middle is taken in every frame. A view
    where nobody agrees gives nothing. Where no two views agree on anybody, every view gives its largest person by score
    times extent.
    """
    count = people[0].shape[1]
    out = np.zeros((len(people), count, 3))
    views = np.repeat(np.arange(len(people)), [len(p) for p in people])
    if not len(views):
        return out
    joints = np.concatenate(list(people))
    chosen = _agreed(rig, views, joints, min_score, max_residual)
    if chosen is None:
        chosen = _largest(views, joints)
    out[views[chosen]] = joints[chosen]
    return out


def _agreed(
    rig: Rig, views: np.ndarray, joints: np.ndarray, min_score: float, max_residual: float
) -> np.ndarray | None:
    """Tracks of the person the views agree on, at most one a view; None when no pair of views agrees on any joint."""
    pairs = pairs_of(views)
    if not len(pairs):
        return None
    tracks = Tracks.of(rig, views, joints, min_score)
    points, agreement = hypotheses(rig, tracks, pairs, max_residual)
    of_track = agreement.sum(axis=1)  # [P, T]
    best = np.stack([np.where(views == v, of_track, 0.0).max(axis=1) for v in range(len(rig))], axis=-1)
    total = best.sum(-1) * _centrality(rig, points, agreement.sum(-1))
    winner = int(total.argmax())
    if total[winner] <= 0:
        return None
    gain = of_track[winner]
    firsts = [int(np.where(views == v, gain, 0.0).argmax()) for v in np.unique(views)]
    return np.array([t for t in firsts if gain[t] > 0], dtype=np.int64)


def _centrality(rig: Rig, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[P] factor in 0..1 of skeletons [P, J, 3] with joint weights [P, J]:
    1 at the rig's focus, 1/2 at the cameras' distance."""
    looked_at = focus(rig)
    radius = np.linalg.norm(rig.centres - looked_at, axis=-1).mean()
    total = weights.sum(-1)
    mean = (
        np.where(weights[..., None] > 0, weights[..., None] * points, 0.0).sum(1)
        / np.where(total > 0, total, 1.0)[:, None]
    )
    distance = np.linalg.norm(mean - looked_at, axis=-1)
    return 1.0 / (1.0 + (distance / max(radius, 1e-6)) ** 2)


def _largest(views: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """For every view with people, the track with the largest sum of scores times diagonal of its joints' box."""
    size = np.zeros(len(views))
    for t, person in enumerate(joints):
        known = person[person[:, 2] > 0]
        if len(known):
            size[t] = known[:, 2].sum() * np.linalg.norm(np.ptp(known[:, :2], axis=0))
    return np.array([np.where(views == v, size, -1.0).argmax() for v in np.unique(views)], dtype=np.int64)
