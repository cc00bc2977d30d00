"""Where joints alone say a body is: limbs as capsules of a person's proportions, the torso between shoulders and
hips, the head."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.cameras import points_to_integer_centres
from posegaussian.storage.model.joint_sets import JointSet, joint_set

TRUNK = ("Hip", "Shoulder")
LENGTHS = {
    TRUNK: 0.50,
    ("Hip", "Knee"): 0.42,
    ("Ankle", "Knee"): 0.41,
    ("Elbow", "Shoulder"): 0.29,
    ("Elbow", "Wrist"): 0.26,
}
"""Metres of a grown person's limbs; a limb seen along its length is shorter, never longer."""
RADII = {
    TRUNK: 0.07, ("Shoulder", "Shoulder"): 0.05, ("Hip", "Hip"): 0.09, ("Hip", "Knee"): 0.07, ("Ankle", "Knee"): 0.045,
    ("Elbow", "Shoulder"): 0.045, ("Elbow", "Wrist"): 0.035,
    ("Ankle", "Heel"): 0.035, ("Ankle", "FootIndex"): 0.035, ("FootIndex", "Heel"): 0.03, ("Ankle", "BigToe"): 0.035,
}  # fmt: skip
"""Metres from a limb's bone to the skin."""
OTHER_RADIUS = 0.03
HEAD_RADIUS, HEAD_ABOVE, NECK_RADIUS = 0.11, 0.04, 0.055
"""Metres: a head is a ball whose middle lies above that of eyes, ears and nose."""
FACE = ("Nose", "LEye", "REye", "LEar", "REar")
TORSO = ("LShoulder", "RShoulder", "RHip", "LHip")
SUB = 4
"""Bits of a pixel's fraction that OpenCV draws with."""


def pixels_per_metre(joints: np.ndarray, set_id: str) -> float:
    """Scale of a picture at a person, from the joints [J, 3] (u, v, score) px; 0 where no limb of known length is seen.

    Every limb gives a lower bound, because it may point at the camera; the second largest is taken, so that one wrong
    joint does no harm.
    """
    known = joint_set(set_id)
    found = []
    for (a, b), kind in zip(known.limbs, _kinds(known), strict=True):
        if kind in LENGTHS and joints[a, 2] > 0 and joints[b, 2] > 0:
            found.append(float(np.linalg.norm(joints[a, :2] - joints[b, :2])) / LENGTHS[kind])
    found.sort()
    return found[-2] if len(found) > 2 else found[-1] if found else 0.0


def body_shape(joints: np.ndarray, set_id: str, size: tuple[int, int], thickness: float = 1.0) -> np.ndarray:
    """[h, w] bool of a picture of `size` (width, height): limbs, torso and head of one person, `thickness` times as
    thick as usual.

    joints [J, 3] (u, v, score) px, our pixel centres; score 0 = unknown, and what hangs on it is left out.
    """
    out = np.zeros((size[1], size[0]), np.uint8)
    scale, known_set = thickness * pixels_per_metre(joints, set_id), joint_set(set_id)
    if scale <= 0:
        return out > 0
    known, at = joints[:, 2] > 0, points_to_integer_centres(joints[:, :2])
    for (a, b), kind in zip(known_set.limbs, _kinds(known_set), strict=True):
        if known[a] and known[b]:
            _capsule(out, at[a], at[b], scale * RADII.get(kind, OTHER_RADIUS))
    names = known_set.names
    torso = [names.index(n) for n in TORSO if n in names]
    if len(torso) == len(TORSO) and known[torso].all():
        cv2.fillConvexPoly(out, _fixed(cv2.convexHull(at[torso].astype(np.float32))[:, 0]), 1, shift=SUB)
    face = [names.index(n) for n in FACE if n in names and known[names.index(n)]]
    if len(face) > 1:
        _head(
            out,
            at[face].mean(axis=0),
            at[torso[:2]].mean(axis=0) if len(torso) == len(TORSO) and known[torso[:2]].all() else None,
            scale,
        )
    return out > 0


def limb_bones(joints: np.ndarray, set_id: str, size: tuple[int, int], thickness: float) -> np.ndarray:
    """[h, w] bool: arms and legs alone, as of `body_shape`."""
    out = np.zeros((size[1], size[0]), np.uint8)
    scale, known_set = thickness * pixels_per_metre(joints, set_id), joint_set(set_id)
    at = points_to_integer_centres(joints[:, :2])
    for (a, b), kind in zip(known_set.limbs, _kinds(known_set), strict=True):
        if kind in LENGTHS and kind != TRUNK and joints[a, 2] > 0 and joints[b, 2] > 0:
            _capsule(out, at[a], at[b], scale * RADII[kind])
    return out > 0


def _head(out: np.ndarray, face: np.ndarray, neck: np.ndarray | None, scale: float) -> None:
    """A ball about the middle of the face [2], moved away from the middle of the shoulders [2] where they are known,
    and the neck between."""
    up = np.array([0.0, -1.0]) if neck is None else (face - neck) / max(float(np.linalg.norm(face - neck)), 1e-9)
    if neck is not None:
        _capsule(out, face, neck, scale * NECK_RADIUS)
    middle = face + scale * HEAD_ABOVE * up
    _capsule(out, middle, middle, scale * HEAD_RADIUS)


def _kinds(known: JointSet) -> list[tuple[str, str]]:
    """Of every limb, the names of its ends without their side, sorted."""
    stems = [n[1:] if n[0] in "LR" and n[1:2].isupper() else n for n in known.names]
    return [(min(stems[a], stems[b]), max(stems[a], stems[b])) for a, b in known.limbs]


def _capsule(out: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float) -> None:
    ends = np.stack([a, b])
    reach = 4.0 * max(out.shape)
    if np.abs(ends).max() > reach:
        return
    across = np.array([a[1] - b[1], b[0] - a[0]])
    across *= radius / max(float(np.linalg.norm(across)), 1e-9)
    cv2.fillConvexPoly(out, _fixed(np.stack([a + across, b + across, b - across, a - across])), 1, shift=SUB)
    for end in ends:
        cv2.circle(out, _fixed(end).tolist(), round(radius * 2**SUB), 1, -1, shift=SUB)


def _fixed(points: np.ndarray) -> np.ndarray:
    return np.rint(np.asarray(points) * 2**SUB).astype(np.int32)
