"""Which joints of people who touch are their own: an estimator puts one's arm on the other's shoulder, and draws a side
that it does not see to the other's."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.frames.bodies.body import LENGTHS, TRUNK, bone_kinds
from posegaussian.stages.geometry.points import NEAR
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

LONGEST = 1.25
"""Length of a bone, over that of a person of the size of the others, from which on it leads to somebody else."""
OUTWARD = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
"""Joints of arms and legs from the trunk outwards."""
SIDES = {
    "Shoulder": (0.35, ("Shoulder", "Elbow", "Wrist", "Pinky", "Index", "Thumb", "Hand")),
    "Hip": (0.22, ("Hip", "Knee", "Ankle", "Heel", "FootIndex", "BigToe", "SmallToe")),
}
"""Metres from the left to the right of a grown person, and the joints that hang on them."""


def own_joints(joints: np.ndarray, set_id: str) -> np.ndarray:
    """[J, 4] (x, y, z, score) world metres of a person [J, 4], score 0 outwards from a bone of arm or leg that is
    longer than theirs can be."""
    out, reach = joints.copy(), LONGEST * person_size(joints, set_id)
    for inner, outer, length in _bones(set_id):
        too_long = np.linalg.norm(joints[inner, :3] - joints[outer, :3]) > reach * length
        if joints[inner, 3] > 0 and (too_long or out[inner, 3] <= 0):
            out[outer, 3] = 0.0
    return out


def not_too_broad(joints: np.ndarray, subject: np.ndarray, set_id: str) -> np.ndarray:
    """[J, 4] joints of somebody else [J, 4]: of shoulders or hips that lie too far apart, the one nearer to the middle
    of the subject [J, 4] moved towards its twin, with all that hangs on it."""
    out, names, size = joints.copy(), joint_set(set_id).names, person_size(joints, set_id)
    middle = np.median(subject[subject[:, 3] > 0, :3], axis=0)
    for part, (breadth, limb) in SIDES.items():
        pair = [j for j, n in enumerate(names) if n in ("L" + part, "R" + part) and joints[j, 3] > 0]
        if len(pair) < 2:
            continue
        near, far = sorted(pair, key=lambda j: float(np.linalg.norm(joints[j, :3] - middle)))
        across = joints[near, :3] - joints[far, :3]
        longer = float(np.linalg.norm(across)) / (size * breadth)
        if longer > LONGEST:
            moved = [j for j, n in enumerate(names) if n[0] == names[near][0] and n[1:] in limb]
            out[moved, :3] -= across * (1 - 1 / longer)
    return out


def _bones(set_id: str) -> list[tuple[int, int, float]]:
    """(joint, the next outwards, metres between) of arms and legs, from the trunk outwards."""
    known = joint_set(set_id)
    found = []
    for (a, b), kind in zip(known.limbs, bone_kinds(known), strict=True):
        if kind in LENGTHS and kind != TRUNK:
            inner, outer = sorted((a, b), key=lambda j: OUTWARD.index(known.names[j][1:]))
            found.append((inner, outer, LENGTHS[kind]))
    return sorted(found, key=lambda bone: OUTWARD.index(known.names[bone[0]][1:]))


def person_size(joints: np.ndarray, set_id: str) -> float:
    """A person's size over that of a grown one, by the median bone of arms and legs of joints [J, 4]; 1 where none is
    known."""
    bones = [(joints[a], joints[b], length) for a, b, length in _bones(set_id)]
    found = [float(np.linalg.norm(a[:3] - b[:3])) / length for a, b, length in bones if a[3] > 0 and b[3] > 0]
    return max(float(np.median(found)), 1e-6) if found else 1.0


def person_depth(rig: Rig, view: int, joints: np.ndarray) -> float:
    """Metres along a view's optical axis to the middle of a person's joints [J, 4] that are known; 0 where none is."""
    depth = joints[:, :3] @ rig.rotations[view, 2] + rig.world_to_camera[view, 2, 3]
    return float(np.median(depth[joints[:, 3] > 0])) if (joints[:, 3] > 0).any() else 0.0


def pixels_per_metre_at(rig: Rig, view: int, joints: np.ndarray, set_id: str) -> float:
    """Scale of a picture at a person's joints in space [J, 4], times their size over a grown one's; 0 where no joint is
    known, or they are behind the camera."""
    depth = person_depth(rig, view, joints)
    focal = float(rig.intrinsics[view, [0, 1], [0, 1]].mean())
    return focal / depth * person_size(joints, set_id) if depth > NEAR else 0.0
