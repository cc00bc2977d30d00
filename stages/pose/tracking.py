"""The subject's joints over time: seen in the views, triangulated, sides put right, occlusions bridged; and where
everybody else is meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.contract.facts import TRACKED
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.following.everybody import CANDIDATES
from posegaussian.stages.geometry.triangulation import unit_of
from posegaussian.stages.pose.bridge import Bones, bridge
from posegaussian.stages.pose.jumps import jumps
from posegaussian.stages.pose.left_right_swaps import Sides, between_views, mended
from posegaussian.stages.pose.params import PoseParams, halo, swap_reach
from posegaussian.stages.pose.subject_detections import numbers_of, others_in_views, span_of, subject_in_views
from posegaussian.storage.model.joint_sets import joint_set

APART = 0.2
"""Seconds from a worked frame to the next beyond which neither tells left from right in the other: who turns round in a
second has turned by more than 72 degrees, and from 90 on left is taken for right."""
ELSEWHERE = 0.5
"""Seconds beyond which it does not tell either where a joint is that nobody sees in the other. Webcams of 6 frames/s,
every second of them: the view that is left out of `desk` gains 2.2 dB by what frames a third of a second away tell."""


@dataclass(frozen=True, eq=False)
class Followed:
    """The subject in the F frames of a partition."""

    joints: np.ndarray
    """[F, V, J, 3] (u, v, score) px of frames/*: detections, left and right as all views and frames agree; zeros
    where there is none."""
    points: np.ndarray
    """[F, J, 4] (x, y, z, score) world metres; 0 score = unknown."""
    bridged: np.ndarray
    """[F, J] bool: known from other frames."""
    exchanged: np.ndarray
    """[F, V, 3] bool: parts (see `swaps`) whose sides were exchanged back."""
    chosen: np.ndarray
    """[F, V] which of the people found is the subject; -1: none, or not told."""
    jumped: list[tuple[int, int, float]]
    """(frame, view, body extents) of jumps of the subject in a view."""


def follow(inputs: Inputs, params: PoseParams, set_id: str) -> Followed:
    """The 2D joints of the subject in the source views, and what they say in space; each frame from those within the
    halo only, and of these from such as follow each other in time.

    Views of a frame are always compared: it takes little where they agree, and no sample of frames could tell that a
    detector exchanges left and right in none. Frames are compared and bridged while `params.bridge` is not 0.
    """
    seen, chosen = subject_in_views(inputs, params, len(joint_set(set_id)))
    first, count = inputs.partition.start - span_of(inputs).start, len(inputs.partition)
    own = range(first, first + count)
    around = range(max(0, own.start - params.bridge), min(len(seen), own.stop + params.bridge))
    sources, sides, bones = list(inputs.views.sources), Sides.of(set_id), Bones.of(set_id)
    rig, limits = inputs.rig.subset(sources), (params.min_score, params.max_residual)
    sightings = [between_views(rig, s, sides, *limits) for s in seen[:, sources]]
    numbers, reach = numbers_of(inputs), swap_reach(params)
    runs = following(numbers, APART * inputs.rate)
    done = [mended(rig, sightings[runs[f]], f - runs[f].start, reach, sides, *limits) for f in around]
    points = np.stack([p for _, p, _ in done])
    at = slice(own.start - around.start, own.stop - around.start)
    joints, exchanged = np.zeros((count, *seen.shape[1:])), np.zeros((count, len(inputs.rig), 3), dtype=bool)
    for f, (found, _, parts) in enumerate(done[at]):
        joints[f, sources], exchanged[f, sources] = found, parts
    out = points[at]
    if params.bridge:
        runs = following(numbers[around.start : around.stop], ELSEWHERE * inputs.rate)
        limit = params.min_score
        out = np.stack(
            [
                bridge(rig, joints[f, sources], points, f + at.start, params.bridge, bones, limit, runs[f + at.start])
                for f in range(count)
            ]
        )
    jumped = []
    if TRACKED in inputs.facts:
        jumped = jumps(seen, numbers / inputs.rate, set_id, own, halo(params, inputs.facts)[0])
    return Followed(
        joints,
        out,
        (out != points[at]).any(axis=-1) & (out[..., 3] > 0),
        exchanged,
        chosen[own.start : own.stop],
        jumped,
    )


def others_in_space(inputs: Inputs, params: PoseParams, set_id: str, subject: np.ndarray) -> np.ndarray:
    """[F, N, J, 4] (x, y, z, score) world metres, of joint set `set_id`, of everybody else who is followed in the F
    frames of the partition, by their number in people/number; score 0 where the views of a frame do not agree on a
    joint.

    subject [F, V, J, 3] px of frames/*: what the views saw of the subject, which is nobody else's; where two people
    touch an estimator gives both the same leg. Nothing is bridged: where an unseen person stands would be a guess at
    whose a pixel is.
    """
    sides, count, sources = Sides.of(set_id), len(joint_set(set_id).names), list(inputs.views.sources)
    rig, out = inputs.rig.subset(sources), np.zeros((len(inputs.partition), CANDIDATES, count, 4))
    for f, people in enumerate(others_in_views(inputs, params, count)):
        for number, joints in people.items():
            reach = params.max_residual * unit_of(rig, np.arange(len(rig)), joints, params.min_score)
            own = np.zeros(joints.shape[:2], bool)
            for seen in (subject[f, sources], subject[f, sources][:, sides.flips]):
                apart = np.linalg.norm(joints[..., :2] - seen[..., :2], axis=-1)
                own |= (apart < reach[:, None]) & (seen[..., 2] > 0)
            theirs = np.where(own[..., None], 0.0, joints)
            out[f, number] = between_views(rig, theirs, sides, params.min_score, params.max_residual).points
    return out


def following(numbers: np.ndarray, most: float) -> list[slice]:
    """[n] for each of ascending source frame numbers the run that it is in, of such as lie at most so many from one to
    the next."""
    ends = [*np.flatnonzero(np.diff(numbers) > most) + 1, len(numbers)]
    starts = [0, *ends[:-1]]
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) for _ in range(a, b)]


def swaps_told(followed: Followed, inputs: Inputs) -> tuple[str, ...]:
    """A sentence on the views and frames in which left and right were exchanged back; none where they were not."""
    swapped = np.asarray(followed.exchanged.any(axis=-1))
    if not swapped.any():
        return ()
    views = ", ".join(f"{inputs.views.names[v]} {int(n)}" for v, n in enumerate(swapped.sum(axis=0)) if n)
    frames = np.flatnonzero(swapped.any(axis=1))
    return (
        (
            f"joints2d: left and right were exchanged, and put back, in {len(frames)} of {len(swapped)} frames, first"
            f" in frame {inputs.source_frames[frames[0]]} (frames by camera: {views})"
        ),
    )
