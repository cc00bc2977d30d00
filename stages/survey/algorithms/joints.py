"""Joints of sampled frames as the survey wants them: of the largest person in runs of frames, and of the
one whom views agree on."""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.detection.reader import joint_reader
from posegaussian.stages.geometry.consistency import reprojection_residual
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.pose.subject_choice import subject
from posegaussian.stages.survey.algorithms.motion import RUN
from posegaussian.storage.model.joint_sets import joint_set, to_set

SCORE = 0.3
"""Least score of a joint that is triangulated."""
RESIDUAL = 0.02
"""Reprojection error above which a view's joint is an outlier, a share as `unit_of` has it."""
FITTING = 0.015
"""Distance of a view's joint from the triangulated one up to which it fits, over the picture's longer side: 3 cm
where a person of 1.75 m fills the picture, and the triangulated joint, a mean over views, is nearer to the true one
than that."""
OF_A_PERSON = 5
"""Joints of at least `SCORE` that make a person; a chair has fewer."""
LEAST = 0.2
"""Extent over that of the picture's largest person: a figure on a poster or far behind is none that could be taken
for the subject."""


def seen_joints(inputs: Inputs, number: int, residual: float = RESIDUAL) -> np.ndarray:
    """[S, 17, 3] COCO-17 (u, v, score) of the subject in the source views of one source frame, px of `frames/*`, from
    the capture's 2D joints, given or estimated.

    `residual`: within which share of the picture's longer side views must agree on whom they see.
    """
    sources = list(inputs.views.sources)
    people = [people_of(inputs, v, number) for v in sources]
    return subject(inputs.rig.subset(sources), people, SCORE, residual)


def people_of(inputs: Inputs, view: int, number: int) -> np.ndarray:
    """[people, 17, 3] COCO-17 (u, v, score) of all that a view shows in one source frame, px of `frames/*`, score 0
    where unknown."""
    joints = joint_reader(inputs)
    found = np.asarray(joints.read(view, number), dtype=np.float64).reshape(-1, len(joint_set(joints.joint_set)), 3)
    found = _known(to_set(found, joints.joint_set, "coco17"))
    crop = inputs.captured_to_calibrated[view]
    pixels, mapped = to_frames(found[..., :2], crop, inputs.source_rig, inputs.rig, view)
    return np.concatenate([pixels, np.where(mapped, found[..., 2], 0.0)[..., None]], axis=-1)


def fit_of_view(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """[3]: median distance, over the picture's longer side, of a view's joints from the triangulated ones, the share
    within FITTING, and how many can be compared a frame in which any was triangulated: in the others nobody is.

    Over the source frames `numbers`; a view that is no source, or where nothing can be compared, gets 0.
    """
    sources = list(inputs.views.sources)
    if view not in sources or not len(numbers):
        return np.zeros(3)
    camera, own = inputs.rig.subset([view]), sources.index(view)
    of_frames = [(seen, space) for seen, space in _met(inputs, numbers) if space[:, 3].any()]
    found = [reprojection_residual(camera, seen[own : own + 1], space) for seen, space in of_frames]
    off = np.concatenate([np.zeros(0), *found]) / inputs.rig.size[view].max()
    if not len(off):
        return np.zeros(3)
    return np.array([np.median(off), (off <= FITTING).mean(), len(off) / len(found)])


def scores_of_view(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """[17] mean score of a view's joints, of the person whom the views agree on, over those of the source frames
    `numbers` in which any was triangulated, or all where none was in any; 0 of a view that is no source."""
    sources = list(inputs.views.sources)
    if view not in sources or not len(numbers):
        return np.zeros(17)
    of_frames = _met(inputs, numbers)
    seen = [seen for seen, space in of_frames if space[:, 3].any()] or [seen for seen, _ in of_frames]
    return np.asarray(np.mean([joints[sources.index(view), :, 2] for joints in seen], axis=0))


def _met(inputs: Inputs, numbers: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of every source frame the joints [S, 17, 3] that source views see, and the triangulated ones [17, 4], score 0
    where there is none."""
    rig = inputs.rig.subset(list(inputs.views.sources))
    seen = [seen_joints(inputs, int(n)) for n in numbers]
    return [(joints, triangulate(rig, joints, SCORE, RESIDUAL)) for joints in seen]


def _known(joints: np.ndarray) -> np.ndarray:
    """Joints [..., J, C] with everything 0 where a value is not finite."""
    return np.where(np.isfinite(joints).all(axis=-1, keepdims=True), joints, 0.0)


def runs_of_joints(inputs: Inputs, view: int, runs: list[np.ndarray]) -> np.ndarray:
    """[R, 4, J, 3] the largest person's joints of one view in runs of consecutive frames, captured pixels.

    Without 2D joints, given 3D joints as a camera without lens would see them.
    """
    if JOINTS2D in inputs.facts:
        joints = joint_reader(inputs)
        found = [[largest(joints.read(view, int(n))) for n in run] for run in runs]
    else:
        joints3d = inputs.source("joints3d")
        found = [[_seen(inputs, view, joints3d.read(int(n))) for n in run] for run in runs]
    return np.array(found) if found else np.zeros((0, RUN, 17, 3))


def _seen(inputs: Inputs, view: int, joints: np.ndarray) -> np.ndarray:
    """[J, 3] (u, v, score) of 3D joints [J, 4]; a joint that is not finite or behind the camera has score 0."""
    known = np.isfinite(joints).all(axis=1)
    pixels, depth = project(
        np.where(known[:, None], joints, 0.0)[:, :3],
        inputs.source_rig.intrinsics[view],
        inputs.source_rig.world_to_camera[view],
    )
    known &= depth > 0
    return np.concatenate([np.where(known[:, None], pixels, 0.0), np.where(known, joints[:, 3], 0.0)[:, None]], axis=1)


def largest(people: np.ndarray) -> np.ndarray:
    """[J, 3] the largest person of [n, J, 3]; zeros of nobody."""
    sorted_ones = by_size(people)
    return sorted_ones[0] if len(sorted_ones) else np.zeros(people.shape[1:])


def people(joints: Any) -> int:
    """How many of joints [people, J, 3] (u, v, score) are people: `OF_A_PERSON` joints are seen, and they are not tiny
    beside the largest."""
    extents = []
    for person in np.asarray(joints, dtype=np.float64).reshape(-1, *np.shape(joints)[1:]):
        seen = person[(person[:, 2] >= SCORE) & np.isfinite(person).all(axis=1)]
        extents.append(float(np.linalg.norm(np.ptp(seen[:, :2], axis=0))) if len(seen) >= OF_A_PERSON else 0.0)
    return int(np.sum(np.array(extents) > LEAST * max(extents))) if extents and max(extents) > 0 else 0


def by_size(people: np.ndarray) -> np.ndarray:
    """[m, J, 3] people of [n, J, 3] who show anything, by the sum of scores times the diagonal of the joints' box, the
    largest first."""
    sizes, known_ones = [], np.where(np.isfinite(people).all(axis=-1, keepdims=True), people, 0.0)
    for person in known_ones:
        known = person[person[:, 2] > 0]
        sizes.append(float(known[:, 2].sum() * np.linalg.norm(np.ptp(known[:, :2], axis=0))) if len(known) else 0.0)
    order = sorted((n for n, size in enumerate(sizes) if size > 0), key=lambda n: -sizes[n])
    return np.asarray(known_ones[order])
