"""How a baked body moves: where its limbs point at a time, from which every bone's rigid motion follows.

Limbs are given as directions in the frame of chest or pelvis, so that every build takes the same pose. The body is
moved up or down until its lower sole stands on the ground, z = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.motion import turn
from posegaussian.stages.simulator.subjects.shoes import SOLE
from posegaussian.stages.simulator.subjects.skeleton import BONES, SIDES, place


@dataclass
class Pose:
    """One moment: where limbs point, and how the trunk is turned."""

    limbs: dict[str, np.ndarray] = field(default_factory=dict)
    """{bone: [3] direction} of upper arms, forearms, thighs and shins; forwards x, left y, up z."""
    turns: dict[str, np.ndarray] = field(default_factory=dict)
    """{bone: [3, 3]} of pelvis, waist, chest, neck, head, hands and feet."""


def _down(forwards: float, outwards: float, side: str) -> np.ndarray:
    """Direction of a limb that hangs, swung forwards and outwards by radians."""
    sign = 1.0 if side == "left_" else -1.0
    return np.array(
        [math.sin(forwards) * math.cos(outwards), sign * math.sin(outwards), -math.cos(forwards) * math.cos(outwards)]
    )


def _wavelike(t: float, period: float, shift: float = 0.0) -> float:
    return math.sin(2.0 * math.pi * (t / period + shift))


def _ease(t: float, start: float, stop: float) -> float:
    x = min(max((t - start) / (stop - start), 0.0), 1.0)
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)


def _standing(style: np.ndarray) -> Pose:
    """At ease: arms beside the body, elbows and knees a little bent."""
    p = Pose()
    for side in SIDES:
        p.limbs[side + "upper_arm"] = _down(0.02, 0.17 + 0.05 * style[0], side)
        p.limbs[side + "forearm"] = _down(0.22 + 0.1 * style[1], 0.06, side)
        p.limbs[side + "thigh"] = _down(0.01, 0.07 + 0.03 * style[2], side)
        p.limbs[side + "shin"] = _down(-0.03, 0.06, side)
    p.turns["head"] = turn("z", 0.15 * style[3])
    return p


def _stand(t: float, style: np.ndarray) -> Pose:
    p = _standing(style)
    p.turns["chest"] = turn("y", 0.012 * _wavelike(t, 3.6)) @ turn("z", 0.02 * _wavelike(t, 5.1))
    p.turns["head"] = p.turns["head"] @ turn("z", 0.08 * _wavelike(t, 4.3, 0.2))
    return p


def _walk(t: float, style: np.ndarray) -> Pose:
    p, period = _standing(style), 1.06
    for side, shift in zip(SIDES, (0.0, 0.5), strict=True):
        swing = _wavelike(t, period, shift)
        lift = max(0.0, _wavelike(t, period, shift + 0.22))
        p.limbs[side + "thigh"] = _down(0.06 + 0.42 * swing + 0.10 * lift, 0.035, side)
        p.limbs[side + "shin"] = _down(0.42 * swing - 0.08 - 0.95 * lift * lift, 0.03, side)
        p.limbs[side + "upper_arm"] = _down(-0.36 * swing, 0.15, side)
        p.limbs[side + "forearm"] = _down(0.28 - 0.42 * swing, 0.05, side)
        p.turns[side + "foot"] = turn("y", 0.10 * swing + 0.45 * lift)
    p.turns["pelvis"] = turn("z", 0.09 * _wavelike(t, period))
    p.turns["chest"] = turn("z", -0.17 * _wavelike(t, period)) @ turn("y", 0.05)
    p.turns["head"] = p.turns["head"] @ turn("z", 0.07 * _wavelike(t, period))
    return p


def _wave(t: float, style: np.ndarray) -> Pose:
    p, beat = _stand(t, style), _wavelike(t, 0.8)
    p.limbs["right_upper_arm"] = np.array([0.18, -0.92, 0.10 + 0.06 * beat])
    p.limbs["right_forearm"] = np.array([0.25, -0.30 + 0.42 * beat, 0.92])
    p.turns["right_hand"] = turn("x", 0.25 * _wavelike(t, 0.8, -0.15))
    p.turns["chest"] = turn("x", 0.04 * beat) @ turn("z", 0.10)
    return p


def _kick(t: float, style: np.ndarray) -> Pose:
    t, p = t % 0.9, _standing(style)
    forth, back = _ease(t, -0.02, 0.22), _ease(t, 0.34, 0.9)
    go = forth - back
    swing = -0.45 + 1.6 * go
    knee = 1.15 * (1.0 - _ease(t, 0.02, 0.22) + back)
    p.limbs["right_thigh"], p.limbs["right_shin"] = _down(swing, 0.06, "right_"), _down(swing - knee, 0.04, "right_")
    p.limbs["left_thigh"], p.limbs["left_shin"] = _down(0.12 - 0.05 * go, 0.06, "left_"), _down(-0.16, 0.04, "left_")
    p.turns["right_foot"] = turn("y", 0.35 * go)
    p.limbs["left_upper_arm"], p.limbs["left_forearm"] = (
        _down(0.7 * swing + 0.1, 0.45, "left_"),
        _down(0.7 * swing + 0.55, 0.30, "left_"),
    )
    p.limbs["right_upper_arm"], p.limbs["right_forearm"] = (
        _down(-0.5 * swing, 0.38, "right_"),
        _down(-0.4 * swing + 0.35, 0.28, "right_"),
    )
    p.turns["pelvis"] = turn("y", -0.12 * go)
    p.turns["chest"] = turn("y", 0.10 * go) @ turn("z", 0.25 * go)
    return p


def _spin(t: float, style: np.ndarray) -> Pose:
    p = _stand(t, style)
    for side in SIDES:
        p.limbs[side + "upper_arm"], p.limbs[side + "forearm"] = _down(0.1, 0.75, side), _down(0.25, 0.70, side)
        p.limbs[side + "thigh"] = _down(0.03, 0.10, side)
    p.turns["pelvis"] = turn("z", 2.0 * math.pi * t / 2.4)
    p.turns["head"] = turn("z", 0.25)
    return p


def _crossed_arms(t: float, style: np.ndarray) -> Pose:
    p, sway = _stand(t, style), _wavelike(t, 2.8)
    p.limbs["left_upper_arm"], p.limbs["right_upper_arm"] = (
        _down(0.55 + 0.03 * sway, -0.12, "left_"),
        _down(0.72 + 0.03 * sway, -0.08, "right_"),
    )
    p.limbs["left_forearm"], p.limbs["right_forearm"] = (
        np.array([0.30, -0.93, 0.02]),
        np.array([0.36, 0.90, 0.22 + 0.03 * sway]),
    )
    p.turns["chest"] = turn("z", 0.22 * sway) @ turn("y", 0.03)
    p.turns["head"] = turn("z", 0.25 * _wavelike(t, 2.8, 0.15))
    return p


def _crouch(t: float, style: np.ndarray) -> Pose:
    p, low = _standing(style), 0.5 - 0.5 * math.cos(2.0 * math.pi * t / 2.6)
    for side in SIDES:
        p.limbs[side + "thigh"] = _down(0.05 + 1.45 * low, 0.10 + 0.28 * low, side)
        p.limbs[side + "shin"] = _down(-0.05 - 0.62 * low, 0.06 + 0.06 * low, side)
        p.limbs[side + "upper_arm"], p.limbs[side + "forearm"] = (
            _down(0.05 + 0.75 * low, 0.16, side),
            _down(0.25 + 1.25 * low, 0.04, side),
        )
        p.turns[side + "foot"] = turn("y", 0.0)
    p.turns["pelvis"], p.turns["chest"] = turn("y", 0.40 * low), turn("y", 0.22 * low)
    p.turns["neck"] = turn("y", -0.35 * low)
    return p


def _throw(t: float, style: np.ndarray) -> Pose:
    t, p = t % 1.6, _standing(style)
    back, forth, home = _ease(t, 0.0, 0.5), _ease(t, 0.5, 0.8), _ease(t, 1.0, 1.6)
    reach = back * (1.0 - home)
    p.limbs["right_upper_arm"] = _down(-0.4 * reach + 1.5 * (forth - home), 0.17 + 1.5 * (back - forth), "right_")
    p.limbs["right_forearm"] = _down(0.25 + 1.9 * back - 0.6 * forth - 1.3 * home, 0.3 * reach, "right_")
    p.limbs["left_upper_arm"] = _down(0.9 * (back - forth), 0.3, "left_")
    p.limbs["left_thigh"], p.limbs["left_shin"] = (
        _down(0.4 * forth * (1 - home), 0.07, "left_"),
        _down(0.1 * forth, 0.05, "left_"),
    )
    p.turns["chest"] = turn("z", -0.5 * (back - forth) + 0.4 * (forth - home))
    return p


MOTIONS: dict[str, Callable[[float, np.ndarray], Pose]] = {
    "stand": _stand,
    "walk": _walk,
    "wave": _wave,
    "kick": _kick,
    "spin": _spin,
    "crossed_arms": _crossed_arms,
    "crouch": _crouch,
    "throw": _throw,
}
"""Pose at a time in seconds; the style is [4] values in -1..1 that make two people differ."""
_ENDS = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}


def _least_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[3, 3] the smallest rotation that takes direction a to b (Rodrigues)."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    v, c = np.cross(a, b), float(a @ b)
    if c < -1.0 + 1e-9:
        raise ValueError("a limb cannot be turned to the opposite of its rest direction")
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + k + k @ k / (1.0 + c)


def bones_at(body: Body, motion: str, time: float, style: np.ndarray) -> np.ndarray:
    """[B, 4, 4] rest to world of every bone at a time in seconds; the lower sole stands at z = 0, the pelvis above the
    origin.

    Raises KeyError for an unknown motion.
    """
    given = MOTIONS[motion](time, style)
    turns = dict(given.turns)
    for side in SIDES:
        for first, second in (("upper_arm", "forearm"), ("thigh", "shin")):
            upper = _least_turn(body.pivot(side + second) - body.pivot(side + first), given.limbs[side + first])
            rest = body.pivot(side + _ENDS[second]) - body.pivot(side + second)
            turns[side + first] = upper
            turns[side + second] = _least_turn(rest, upper.T @ given.limbs[side + second])
        # a foot stays level with the pelvis whatever the leg does, but for its own turn
        leg = turns[side + "thigh"] @ turns[side + "shin"]
        pelvis = turns.get("pelvis", np.eye(3))
        tilt = _least_turn(pelvis @ np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])) @ pelvis
        level = _half_way(leg.T @ pelvis.T @ tilt)
        turns[side + "foot"] = level @ turns.get(side + "foot", np.eye(3))
    shift = np.array([0.0, 0.0, 0.0]) - np.array([*body.pivot("pelvis")[:2], 0.0])
    placed = place(body.pivots, turns, shift)
    shift[2] -= min(float((m @ np.array([*p, 1.0]))[2]) for m, p in ((placed[b], p) for b, p in _soles(body)))
    return place(body.pivots, turns, shift)


def _half_way(rotation: np.ndarray) -> np.ndarray:
    """The rotation itself up to 45 degrees, else its part up to there: an ankle does not bend further."""
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (np.trace(rotation) - 1.0))))
    if angle < 1e-9:
        return np.eye(3)
    axis = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    ) / (2.0 * math.sin(angle))
    a = min(angle, math.pi / 4)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + math.sin(a) * k + (1.0 - math.cos(a)) * k @ k


def _soles(body: Body) -> list[tuple[int, np.ndarray]]:
    """Points under heel and toes of both shoes at rest, and the bones they follow."""
    out = []
    for side in SIDES:
        ankle, toes = body.pivot(side + "foot"), body.pivot(side + "toes")
        ahead = (toes - ankle)[:2] / np.linalg.norm((toes - ankle)[:2])
        out.append((BONES.index(side + "foot"), np.array([*(ankle[:2] - 0.055 * ahead), -SOLE])))
        out.append((BONES.index(side + "toes"), np.array([*(toes[:2] + 0.07 * ahead), -SOLE])))
    return out
