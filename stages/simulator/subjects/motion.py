"""The body at rest and its motions: bones that turn about their joints.

Z up, feet at z = 0, 1.75 m tall, facing +x, left is +y. At rest the person stands with the arms a little off the body;
all positions below are in that pose, metres. A motion gives each bone a rigid motion from rest to world.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.simulator.render.raycast import ELLIPSOID, ROUND_CONE
from posegaussian.stages.simulator.render.texture import EYES, HAIR, SHIRT, SHOES, SKIN, TROUSERS

HEIGHT = 1.75
BONES: tuple[tuple[str, str | None, tuple[float, float, float]], ...] = (
    ("pelvis", None, (0.0, 0.0, 0.95)),
    ("torso", "pelvis", (0.0, 0.0, 1.02)),
    ("head", "torso", (-0.01, 0.0, 1.49)),
    ("left_upper_arm", "torso", (0.0, 0.19, 1.405)),
    ("left_forearm", "left_upper_arm", (0.0, 0.29, 1.15)),
    ("left_hand", "left_forearm", (0.02, 0.37, 0.91)),
    ("left_thigh", "pelvis", (0.0, 0.095, 0.92)),
    ("left_shin", "left_thigh", (0.01, 0.11, 0.50)),
    ("left_foot", "left_shin", (-0.02, 0.12, 0.085)),
)
"""(bone, parent, joint it turns about); the right side mirrors the left one at y = 0."""


def _mirrored() -> tuple[tuple[str, str | None, np.ndarray], ...]:
    out = [(n, p, np.array(j)) for n, p, j in BONES]
    flip = np.array([1.0, -1.0, 1.0])
    right = [
        (n.replace("left", "right"), p and p.replace("left", "right"), j * flip)
        for n, p, j in out
        if n.startswith("left")
    ]
    return (*out, *right)


SKELETON = _mirrored()
BONE_NAMES = tuple(n for n, _, _ in SKELETON)
_PIVOT = {n: j for n, _, j in SKELETON}

_BALLS = (
    ("pelvis", TROUSERS, (0.0, 0.0, 0.965), (0.118, 0.168, 0.125)),
    ("torso", SHIRT, (0.0, 0.0, 1.12), (0.106, 0.150, 0.165)),
    ("torso", SHIRT, (0.005, 0.0, 1.30), (0.122, 0.185, 0.175)),
    ("head", SKIN, (0.012, 0.0, 1.612), (0.100, 0.077, 0.122)),
    ("head", HAIR, (-0.014, 0.0, 1.648), (0.100, 0.086, 0.102)),
    ("head", SKIN, (0.108, 0.0, 1.605), (0.022, 0.014, 0.024)),
    ("left_foot", SHOES, (0.055, 0.125, 0.047), (0.140, 0.050, 0.047)),
)
_CONES = (
    ("torso", SHIRT, (0.0, -0.15, 1.405), (0.0, 0.15, 1.405), 0.062, 0.062),
    ("torso", SHIRT, (0.0, 0.0, 1.43), (0.0, 0.13, 1.405), 0.074, 0.060),
    ("torso", SHIRT, (0.0, 0.0, 1.43), (0.0, -0.13, 1.405), 0.074, 0.060),
    ("head", SKIN, (-0.012, 0.0, 1.42), (-0.005, 0.0, 1.57), 0.058, 0.052),
    ("left_upper_arm", SHIRT, (0.0, 0.19, 1.405), (0.0, 0.255, 1.245), 0.060, 0.055),
    ("left_upper_arm", SKIN, (0.0, 0.248, 1.264), (0.0, 0.29, 1.15), 0.048, 0.041),
    ("left_forearm", SKIN, (0.0, 0.29, 1.15), (0.02, 0.37, 0.91), 0.042, 0.029),
    ("left_hand", SKIN, (0.022, 0.377, 0.885), (0.032, 0.395, 0.80), 0.040, 0.028),
    ("left_thigh", TROUSERS, (0.0, 0.095, 0.92), (0.01, 0.11, 0.50), 0.090, 0.061),
    ("left_shin", TROUSERS, (0.01, 0.11, 0.50), (-0.02, 0.12, 0.115), 0.061, 0.046),
)


def _parts() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rows = [(ELLIPSOID, bone, m, np.array([*c, *r, 0.0, 0.0])) for bone, m, c, r in _BALLS]
    rows += [(ROUND_CONE, bone, m, np.array([*a, *b, ra, rb])) for bone, m, a, b, ra, rb in _CONES]
    for kind, bone, m, g in list(rows):
        if bone.startswith("left"):
            flipped = g.copy()
            flipped[1] *= -1.0
            flipped[4] *= 1.0 if kind == ELLIPSOID else -1.0
            rows.append((kind, bone.replace("left", "right"), m, flipped))
    index = {n: i for i, n in enumerate(BONE_NAMES)}
    return (
        np.array([r[0] for r in rows]),
        np.array([index[r[1]] for r in rows]),
        np.array([r[2] for r in rows]),
        np.array([r[3] for r in rows]),
    )


KINDS, PART_BONES, MATERIALS, GEOMETRY = _parts()
"""[P] kind, [P] bone, [P] material, [P, 8] geometry at rest of every primitive."""

_EARS = np.array([[-0.005, 0.082, 1.615], [-0.005, -0.082, 1.615]])
_JOINTS: tuple[tuple[str, np.ndarray], ...] = (
    ("head", np.array([0.130, 0.0, 1.605])),
    ("head", EYES[0]),
    ("head", EYES[1]),
    ("head", _EARS[0]),
    ("head", _EARS[1]),
    *(
        (f"{side}_{bone}", _PIVOT[f"{side}_{bone}"])
        for bone in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot")
        for side in ("left", "right")
    ),
)
JOINT_BONES = np.array([BONE_NAMES.index(b) for b, _ in _JOINTS])
JOINTS = np.array([p for _, p in _JOINTS])
"""[17, 3] COCO-17 at rest: nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles; left before right."""


def turn(axis: str, angle: float) -> np.ndarray:
    """[3, 3] rotation about a world axis by radians, right-handed: about y it swings what hangs down backwards (-x)."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def _stand(t: float) -> dict[str, np.ndarray]:
    return {}


def _wave(t: float) -> dict[str, np.ndarray]:
    beat = 2.0 * math.pi * t / 0.8
    sway = 0.03 * math.sin(beat / 2.0)
    return {
        "torso": turn("x", sway),
        "head": turn("z", 0.12 * math.sin(beat / 2.0)) @ turn("x", -sway),
        "right_upper_arm": turn("x", -1.35 + 0.06 * math.sin(beat)) @ turn("z", 0.25),
        "right_forearm": turn("x", -0.85 + 0.45 * math.sin(beat)),
        "right_hand": turn("x", 0.25 * math.sin(beat - 0.8)),
        "left_upper_arm": turn("y", 0.15 * math.sin(beat / 2.0)),
        "left_forearm": turn("y", -0.25),
    }


def _ease(t: float, start: float, stop: float) -> float:
    x = min(max((t - start) / (stop - start), 0.0), 1.0)
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)


def _kick(t: float) -> dict[str, np.ndarray]:
    t %= 0.8
    # The kick itself takes six frames at 30 Hz and is under way in the first; the leg comes back in half a second.
    forth, back = _ease(t, -0.04, 0.19), _ease(t, 0.30, 0.8)
    swing = -0.45 + 1.55 * (forth - back)
    knee = 1.15 * (1.0 - _ease(t, 0.0, 0.19) + back)
    lean = -0.16 * (forth - back)
    return {
        "torso": turn("y", lean),
        "head": turn("y", -0.6 * lean),
        "right_thigh": turn("y", -swing),
        "right_shin": turn("y", knee),
        "right_foot": turn("y", 0.35),
        "left_upper_arm": turn("y", -0.7 * swing) @ turn("x", 0.35),
        "left_forearm": turn("y", -0.4),
        "right_upper_arm": turn("y", 0.5 * swing) @ turn("x", -0.35),
        "right_forearm": turn("y", -0.3),
    }


MOTIONS = {"stand": _stand, "wave": _wave, "kick": _kick}


def pose(motion: str, time: float) -> np.ndarray:
    """[B, 4, 4] rest to world of every bone at a time in seconds.

    Raises ValueError with the known names for an unknown motion.
    """
    if motion not in MOTIONS:
        raise ValueError(f"unknown motion {motion!r}; the motions are {', '.join(MOTIONS)}")
    turns = MOTIONS[motion](time)
    placed: dict[str, np.ndarray] = {}
    for name, parent, pivot in SKELETON:
        local = np.eye(4)
        if name in turns:
            local[:3, :3] = turns[name]
            local[:3, 3] = pivot - turns[name] @ pivot
        placed[name] = local if parent is None else placed[parent] @ local
    return np.stack([placed[n] for n in BONE_NAMES])


def joints_at(bones: np.ndarray) -> np.ndarray:
    """[17, 3] COCO-17 joints in the world, metres, of a pose [B, 4, 4]."""
    m = bones[JOINT_BONES]
    return np.einsum("jab,jb->ja", m[:, :3, :3], JOINTS) + m[:, :3, 3]
