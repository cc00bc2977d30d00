"""Scenes that are like captures: dark and glossy cloth, plain cloth, folds, straps, things in hands, loose hair, soft
mattes, cameras that are rolled, tilted and unevenly placed, few of them, and exposures that differ here and there.

Eight are fixed and for reporting, beside those of `quality_scenes`; scenes of the same kinds follow from any seed below
9000, for tuning, training and validation, with the people that may be seen there (`subjects.splits`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.quality_scenes import FRAME_RATE
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED

CAPTURE_LIKE_SEEDS = range(9100, 9108)
"""For figures that are published; tune on scenes of other seeds."""
FRAMES = 3


@dataclass(frozen=True)
class Likeness:
    """What one of the scenes holds."""

    cameras: int
    """Number of source cameras."""
    rig: Mapping[str, Any] = field(default_factory=dict)
    """Of the scene's rig, laid over an upright ring."""
    subject: Mapping[str, Any] = field(default_factory=dict)
    """What is worn and carried beyond the outfit."""
    motion: str = "walk"
    effects: Mapping[str, Any] = field(default_factory=dict)
    """Laid over light and gloss."""
    frames: int = FRAMES


_ROLLED, _TILTED = {"roll": 90.0}, {"tilt": 14.0, "height": 1.4}
_UNEVEN, _ARC = {"jitter": 0.25, "roll_spread": 25.0}, {"kind": "arc", "span": 105.0}
_SOFT, _APART = {"soft_matte": {"width": 3.0}}, {"camera_gain": {"exposure": 0.35, "white_balance": 0.03}}
_BLACK, _UMBER, _GREY, _SAND, _NAVY = (
    [[r, g, b]] for r, g, b in ((27, 25, 25), (46, 36, 30), (126, 127, 130), (176, 160, 132), (30, 36, 58))
)
_LEATHER, _PLAIN = (
    {"colors": _BLACK, "material": "leather", "folds": 0.010},
    {"colors": _GREY, "material": "cotton", "folds": 0.008},
)
_PRINT = {"pattern": "print", "colors": [[196, 182, 150], [52, 74, 96], [140, 58, 44]], "scale": 0.07, "folds": 0.006}
_SHORT, _WILD = {"strands": 5000, "length": 0.045}, {"strands": 9000, "length": 0.10, "loose": 0.3}


def _over(*kinds: str) -> list[dict[str, Any]]:
    return [{"kind": kind} for kind in kinds]


LIKENESSES: dict[int, Likeness] = {
    9100: Likeness(
        16,
        subject={
            "upper": _LEATHER,
            "lower": {**_LEATHER, "colors": _UMBER},
            "straps": _over("sash", "belt", "thighs", "bracers"),
            "carries": [{"thing": "helmet", "material": "metal"}],
            "hair": _SHORT,
        },
    ),
    9101: Likeness(
        8,
        _ROLLED,
        {"upper": _PLAIN, "lower": {"colors": _SAND, "folds": 0.008}, "carries": [{"thing": "bag"}], "hair": _WILD},
        "stand",
        _SOFT,
    ),
    9102: Likeness(
        6,
        _TILTED,
        {
            "upper": _PRINT,
            "lower": {"colors": _NAVY, "folds": 0.007},
            "straps": _over("harness"),
            "carries": [{"thing": "board", "hand": "right", "pattern": "print"}],
        },
    ),
    9103: Likeness(
        4,
        _ARC,
        {
            "upper": {**_LEATHER, "material": "lacquer"},
            "lower": _LEATHER,
            "straps": _over("harness", "belt"),
            "hair": _WILD,
        },
        "kick",
        frames=1,
    ),
    9104: Likeness(
        16,
        _UNEVEN,
        {"upper": {"colors": _SAND, "material": "satin", "folds": 0.012}, "lower": _PLAIN, "straps": _over("belt")},
        "crouch",
        {**_SOFT, **_APART},
    ),
    9105: Likeness(
        8,
        {},
        {
            "upper": _LEATHER,
            "lower": {"folds": 0.007},
            "straps": _over("sash", "thighs"),
            "carries": [{"thing": "helmet", "hand": "right"}, {"thing": "bag", "hand": "left"}],
            "hair": _SHORT,
        },
        "stand",
        {**_SOFT, "background_room": {}},
    ),
    9106: Likeness(
        6,
        {**_ROLLED, "jitter": 0.2},
        {"upper": {"colors": _BLACK, "folds": 0.009}, "lower": {"colors": _BLACK}, "carries": [{"thing": "board"}]},
        "walk",
        _APART,
    ),
    9107: Likeness(
        4,
        {**_ARC, "roll": -20.0},
        {
            "upper": {"colors": _GREY, "folds": 0.010},
            "lower": {"colors": _NAVY, "material": "lacquer", "folds": 0.006},
            "straps": _over("bracers"),
            "hair": _WILD,
        },
        "crossed_arms",
        _SOFT,
    ),
}
"""What each of the reporting seeds holds. All are lit alike and shine; exposures differ in two."""
_PHASES = {"walk": (0.0, 1.06), "stand": (0.0, 3.0), "kick": (0.05, 0.40), "crossed_arms": (0.0, 2.8)}
_PHASES |= {"crouch": (0.6, 0.9)}
"""Seconds into the motion between which the first frame lies."""


def _drawn(seed: int) -> Likeness:
    """The same kinds, by the seed."""
    random = generator(seed, "capture_like kinds")

    def one(*choices: Any) -> Any:
        return choices[int(random.integers(len(choices)))]

    def cloth() -> dict[str, Any]:
        if random.random() < 0.2:
            return {"folds": float(random.uniform(0.0, 0.012))}
        if random.random() < 0.2:
            colors = random.integers(20, 230, (3, 3)).tolist()
            return {"pattern": "print", "colors": colors, "scale": float(random.uniform(0.04, 0.12)), "folds": 0.006}
        dark = random.random() < 0.5
        tone = random.uniform(24, 50) if dark else random.uniform(70, 210)
        color = np.clip(tone + random.normal(size=3) * 0.15 * tone, 14, 235).astype(int).tolist()
        material = one("leather", "leather", "lacquer", "cotton") if dark else one("cotton", "cotton", "satin")
        return {"colors": [color], "material": material, "folds": float(random.uniform(0.0, 0.012))}

    subject: dict[str, Any] = {"upper": cloth(), "lower": cloth()}
    kinds = ("sash", "harness", "belt", "thighs", "bracers")
    if random.random() < 0.5:
        worn = random.permutation(len(kinds))[: int(random.integers(1, 4))]
        subject["straps"] = [
            {
                "kind": kinds[k],
                "width": float(random.uniform(0.025, 0.05)),
                "material": one("leather", "cotton", "satin"),
            }
            for k in sorted(worn)
        ]
    holds = random.random() < 0.5
    if holds:
        subject["carries"] = [
            {
                "thing": one("helmet", "bag", "board"),
                "hand": one("left", "right"),
                "pattern": one("plain", "print"),
                "colors": random.integers(20, 210, (3, 3)).tolist(),
                "material": one("cotton", "satin", "metal"),
            }
        ]
    if random.random() < 0.6:
        strands, length = int(random.integers(3000, 9000)), float(random.uniform(0.03, 0.11))
        subject["hair"] = {"strands": strands, "length": length, "loose": float(random.uniform(0.2, 0.6))}
    cameras = one(4, 6, 8, 16)
    rig = one({}, {}, _ROLLED, _TILTED, _UNEVEN, {"roll": float(random.uniform(-180.0, 180.0))})
    if cameras == 4:
        rig = {**_ARC, **{k: v for k, v in rig.items() if k not in _TILTED}}
    effects: dict[str, Any] = {}
    if random.random() < 0.5:
        effects["soft_matte"] = {"width": float(random.uniform(1.0, 5.0))}
    if random.random() < 0.25:
        effects |= _APART
    motion = one("walk", "stand", "kick") if holds else one(*_PHASES)
    return Likeness(cameras, rig, subject, motion, effects)


def capture_like_scene(
    seed: int, cameras: int | None = None, size: int = 512, frames: int | None = None, held_out: int = 2
) -> Scene:
    """The scene of one seed, `size` px square, with `held_out` cameras midway between neighbours.

    Of the seeds for reporting `LIKENESSES` says what each holds; below 9000 that is drawn. `cameras` replaces the
    scene's own number, and `frames` is the most there are: a scene of a single frame stays one. The lens fits the
    person at rest, so that it is the same for every number of cameras. Raises ValueError for other seeds.
    """
    if not 0 <= seed < FIRST_KEPT_SEED and seed not in CAPTURE_LIKE_SEEDS:
        raise ValueError(
            f"seed {seed} of a scene like a capture: 0-{FIRST_KEPT_SEED - 1} are drawn,"
            f" {CAPTURE_LIKE_SEEDS.start}-{CAPTURE_LIKE_SEEDS.stop - 1} are for reporting"
        )
    like = LIKENESSES[seed] if seed in LIKENESSES else _drawn(seed)
    random = generator(seed, "capture_like")
    side = 25.0 if like.rig.get("kind") == "arc" else 180.0  # an arc sees the person's front, or nearly so
    return Scene.model_validate(
        {
            "seed": seed,
            "frames": like.frames if frames is None else min(frames, like.frames),
            "frame_rate": FRAME_RATE,
            "samples": 3,
            "subject": {"heading": float(random.uniform(-1.0, 1.0)) * side, **like.subject},
            "motion": {"name": like.motion, "phase": float(random.uniform(*_PHASES[like.motion]))},
            "rig": {
                "kind": "ring",
                "cameras": like.cameras if cameras is None else cameras,
                "radius": 4.5,
                "height": 1.1,
                "size": [size, size],
                "fill": 0.76,
                **like.rig,
            },
            "held_out": held_out,
            "effects": {"ambient_occlusion": {}, "cast_shadow": {}, "specular": {}, **like.effects},
        }
    )
