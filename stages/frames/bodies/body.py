"""Where joints alone say a body is: limbs as capsules of a person's proportions, the torso between shoulders and
hips, the head."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres
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
BESIDE_NECK = ("Ear", "Shoulder")
"""A limb of some joint sets that is none of a body: what lies beside the neck is behind it."""
FACE = ("Nose", "LEye", "REye", "LEar", "REar")
TORSO = ("LShoulder", "RShoulder", "RHip", "LHip")
SUB = 4
"""Bits of a pixel's fraction that OpenCV draws with."""


def pixels_per_metre(joints: np.ndarray, set_id: str) -> float:
    """Scale of a picture at a person, from the joints [J, 3] (u, v, score) px; 0 where no limb of known length is seen.

    Every limb gives a lower bound, because it may point at the camera; the second largest is taken, so that one wrong
    joint does no harm. Of somebody all of whom points there it is too small: where joints are known in space
    `posegaussian.stages.frames.bodies.own_joints.pixels_per_metre_at` is right.
    """
    known = joint_set(set_id)
    found = []
    for (a, b), kind in zip(known.limbs, bone_kinds(known), strict=True):
        if kind in LENGTHS and joints[a, 2] > 0 and joints[b, 2] > 0:
            found.append(float(np.linalg.norm(joints[a, :2] - joints[b, :2])) / LENGTHS[kind])
    found.sort()
    return found[-2] if len(found) > 2 else found[-1] if found else 0.0


def body_shape(joints: np.ndarray, set_id: str, size: tuple[int, int], scale: float) -> np.ndarray:
    """[h, w] bool of a picture of `size` (width, height): limbs, torso and head of one person.

    joints [J, 3] (u, v, score) px, our pixel centres; score 0 = unknown, and what hangs on it is left out. scale: px of
    a metre there, times the person's size over a grown one's.
    """
    out = np.zeros((size[1], size[0]), np.uint8)
    for part in _parts(joints, set_id, scale):
        part.draw(out)
    return out > 0


def body_depth(joints: np.ndarray, depth: np.ndarray, set_id: str, size: tuple[int, int], scale: float) -> np.ndarray:
    """[h, w] float32 metres along the optical axis, of the nearest bone where `body_shape` has a body; infinite
    elsewhere.

    joints [J, 3] as there, depth [J] metres of each. Of bones, not of the skin, because only these are known.
    """
    out, drawn = np.full((size[1], size[0]), np.inf, np.float32), np.zeros((size[1], size[0]), np.uint8)
    for part in _parts(joints, set_id, scale):
        part.draw(drawn)
        left, top, width, height = cv2.boundingRect(drawn)
        box = slice(top, top + height), slice(left, left + width)
        there = part.depth(pixel_centres((width, height)) + np.array([left, top]), depth)
        out[box] = np.where(drawn[box] > 0, np.minimum(out[box], there), out[box])
        drawn[box] = 0
    return out


def limb_bones(joints: np.ndarray, set_id: str, size: tuple[int, int], scale: float) -> np.ndarray:
    """[h, w] bool: arms and legs alone, as of `body_shape`."""
    out, known_set = np.zeros((size[1], size[0]), np.uint8), joint_set(set_id)
    at = points_to_integer_centres(joints[:, :2])
    for (a, b), kind in zip(known_set.limbs, bone_kinds(known_set), strict=True):
        if kind in LENGTHS and kind != TRUNK and joints[a, 2] > 0 and joints[b, 2] > 0:
            _capsule(out, at[a], at[b], scale * RADII[kind])
    return out > 0


@dataclass(frozen=True, eq=False)
class _Part:
    """A capsule, or the torso, in a picture."""

    at: np.ndarray
    """[2, 2] ends of a capsule's bone, or [4, 2] corners of the torso, px of integer centres."""
    of: tuple[list[int], ...]
    """Of each of these, the joints as deep as it."""
    radius: float
    """Px; of a capsule."""

    def draw(self, out: np.ndarray) -> None:
        """Set its pixels of [h, w] uint8 to 1."""
        if len(self.at) == 2:
            _capsule(out, self.at[0], self.at[1], self.radius)
        else:
            cv2.fillConvexPoly(out, _fixed(cv2.convexHull(self.at.astype(np.float32))[:, 0]), 1, shift=SUB)

    def depth(self, pixels: np.ndarray, of_joints: np.ndarray) -> np.ndarray:
        """[h, w] metres at pixels [h, w, 2]: of the bone where it is nearest to each, of the plane nearest to the
        torso's corners; of_joints [J] metres."""
        ends, pixels = np.array([of_joints[j].mean() for j in self.of]), points_to_integer_centres(pixels)
        if len(ends) == 2:
            along = self.at[1] - self.at[0]
            share = np.clip((pixels - self.at[0]) @ along / max(float(along @ along), 1e-9), 0, 1)
            return np.asarray(ends[0] + share * (ends[1] - ends[0]))
        middle = self.at.mean(axis=0)
        slope = np.linalg.lstsq(self.at - middle, ends - ends.mean(), rcond=0.1)[0]
        return np.asarray(np.clip(ends.mean() + (pixels - middle) @ slope, ends.min(), ends.max()))


def _parts(joints: np.ndarray, set_id: str, scale: float) -> Iterator[_Part]:
    """What a body is made of in a picture, of joints [J, 3] and a scale as of `body_shape`."""
    if scale <= 0:
        return
    known_set = joint_set(set_id)
    known, at = joints[:, 2] > 0, points_to_integer_centres(joints[:, :2])
    for (a, b), kind in zip(known_set.limbs, bone_kinds(known_set), strict=True):
        if known[a] and known[b] and kind != BESIDE_NECK:
            yield _Part(at[[a, b]], ([a], [b]), scale * RADII.get(kind, OTHER_RADIUS))
    names = known_set.names
    torso = [names.index(n) for n in TORSO if n in names]
    if len(torso) == len(TORSO) and known[torso].all():
        yield _Part(at[torso], tuple([j] for j in torso), 0.0)
    face = [names.index(n) for n in FACE if n in names and known[names.index(n)]]
    if len(face) > 1:
        whole = len(torso) == len(TORSO) and bool(known[torso[:2]].all())
        yield from _head(at, face, torso[:2] if whole else None, scale)


def _head(at: np.ndarray, face: list[int], shoulders: list[int] | None, scale: float) -> Iterator[_Part]:
    """A ball about the middle of the face, moved away from the middle of the shoulders where they are known, and the
    neck between; at [J, 2] px."""
    middle, up = at[face].mean(axis=0), np.array([0.0, -1.0])
    if shoulders is not None:
        neck = at[shoulders].mean(axis=0)
        up = (middle - neck) / max(float(np.linalg.norm(middle - neck)), 1e-9)
        yield _Part(np.stack([middle, neck]), (face, shoulders), scale * NECK_RADIUS)
    ball = middle + scale * HEAD_ABOVE * up
    yield _Part(np.stack([ball, ball]), (face, face), scale * HEAD_RADIUS)


def bone_kinds(known: JointSet) -> list[tuple[str, str]]:
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
