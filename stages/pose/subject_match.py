"""Which of the people that an estimator found is the subject whose joints came with the capture."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.pose.subject_detections import DETECTIONS, in_frames
from posegaussian.storage.model.joint_sets import BLAZEPOSE33, joint_set, to_set

FEWEST = 5
"""Joints that both must have before they are compared."""
SAME = 0.12
"""Median distance of two detectors' joints, as a share of the body's extent, up to which they are one person: they
put hips and shoulders 2 % apart, and a person beside the subject is a quarter of a body away."""
FLIPS = np.array(joint_set("coco17").flips)


def found_subject(inputs: Inputs, joints: np.ndarray, set_id: str) -> np.ndarray:
    """[F, V] index among the people of detection/* of the subject; -1 where the estimator did not find the subject.

    joints [F, V, J, 3] (u, v, score) px of frames/*, of joint set `set_id`: the subject in every view of the partition.
    """
    out = np.full(joints.shape[:2], -1)
    first = inputs.partition.start - inputs.span(DETECTIONS).start
    for v in inputs.views.sources:
        found = np.asarray(inputs.read(DETECTIONS, v))[first : first + len(joints)]
        for f in range(len(joints)):
            people = to_set(in_frames(inputs, v, found[f]), BLAZEPOSE33.id, "coco17")
            out[f, v] = nearest(people, to_set(joints[f, v], set_id, "coco17"))
    return out


def nearest(people: np.ndarray, subject: np.ndarray) -> int:
    """Index of the person [P, 17, 3] that lies on the subject [17, 3], px; -1 where none does. Left and right do not
    count: an estimator mirrors whom it sees from behind."""
    known = subject[:, 2] > 0
    if known.sum() < FEWEST:
        return -1
    extent = float(np.linalg.norm(np.ptp(subject[known, :2], axis=0)))
    off = [min(_apart(p, subject), _apart(p[FLIPS], subject)) for p in people]
    best = int(np.argmin(off)) if off else -1
    return best if best >= 0 and off[best] <= SAME * extent else -1


def _apart(person: np.ndarray, subject: np.ndarray) -> float:
    """Median distance, px, of the joints [17, 3] that both have; infinite where they are too few."""
    both = (person[:, 2] > 0) & (subject[:, 2] > 0)
    return float(np.median(np.linalg.norm((person - subject)[both, :2], axis=1))) if both.sum() >= FEWEST else np.inf
