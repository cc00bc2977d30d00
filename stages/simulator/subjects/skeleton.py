"""The skeleton of a baked body: names and parents of its bones, and which joint lies where."""

from __future__ import annotations

import numpy as np

SIDES = ("left_", "right_")
_CHAINS = (
    ("clavicle", "chest"),
    ("upper_arm", "clavicle"),
    ("forearm", "upper_arm"),
    ("hand", "forearm"),
    ("thigh", "pelvis"),
    ("shin", "thigh"),
    ("foot", "shin"),
    ("toes", "foot"),
)
_MIDLINE = (("pelvis", ""), ("waist", "pelvis"), ("chest", "waist"), ("neck", "chest"), ("head", "neck"))
_PAIRS = (*_MIDLINE, *((side + b, p if p in dict(_MIDLINE) else side + p) for side in SIDES for b, p in _CHAINS))

BONES: tuple[str, ...] = tuple(b for b, _ in _PAIRS)
"""Names; a parent comes before its children."""
PARENTS: tuple[int, ...] = tuple(BONES.index(p) if p else -1 for _, p in _PAIRS)
"""Index of every bone's parent; -1 for the root."""

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_LIMBS = tuple(side + b for b in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot") for side in SIDES)
JOINT_BONES: tuple[str, ...] = (*(f"={n}" for n in _FACE), *_LIMBS)
"""Where each COCO-17 joint comes from:
`=name` is a point of the face that moves with the head, else the pivot of that bone."""
CARRIERS: np.ndarray = np.array([BONES.index("head") if j.startswith("=") else BONES.index(j) for j in JOINT_BONES])
"""[17] bone that each joint moves with."""


def place(pivots: np.ndarray, turns: dict[str, np.ndarray], shift: np.ndarray | None = None) -> np.ndarray:
    """[B, 4, 4] rest to world: every bone turns about its pivot by a rotation given in world axes at rest, parents
    first.

    pivots [B, 3] at rest, metres; turns {bone: [3, 3]}; shift [3] moves the whole body.
    """
    out = np.empty((len(BONES), 4, 4))
    for b, name in enumerate(BONES):
        local = np.eye(4)
        if name in turns:
            local[:3, :3] = turns[name]
            local[:3, 3] = pivots[b] - turns[name] @ pivots[b]
        if PARENTS[b] < 0 and shift is not None:
            local[:3, 3] += shift
        out[b] = local if PARENTS[b] < 0 else out[PARENTS[b]] @ local
    return out
