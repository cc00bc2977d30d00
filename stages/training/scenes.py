"""Scenes that the network is trained on: people, motions, cameras and faults, all from the number of the scene.

Nobody who is kept for measuring plays here (`posegaussian.stages.simulator.subjects.splits`): seeds below 8000 train,
seeds from 8000 on validate, with a subject and a motion that training never shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED, FIRST_VALIDATION_SEED, casting
from posegaussian.stages.training.wardrobe import extras

FAULTS: tuple[tuple[float, str, Mapping[str, tuple[float, float]]], ...] = (
    (0.5, "sensor_noise", {"electrons": (1500, 12000), "read": (3, 12)}),
    (0.5, "camera_gain", {"exposure": (0.01, 0.15), "white_balance": (0.0, 0.04)}),
    (0.4, "specular", {"strength": (0.5, 4.0)}),
    (0.4, "calibration_error", {"pixels": (0.1, 0.8)}),
    (0.4, "mask_error", {"wobble": (0.2, 1.2), "grow": (-1.5, 1.5)}),
    (0.3, "soft_matte", {"width": (1.0, 6.0)}),
    (0.4, "background_room", {"side": (14.0, 18.0)}),
    (0.3, "cast_shadow", {}),
    (0.3, "vignetting", {"corner": (0.05, 0.4)}),
    (0.3, "jpeg", {"quality": (60, 95)}),
    (0.2, "cloth_motion", {}),
    (0.15, "depth_of_field", {"aperture": (0.005, 0.03)}),
)
"""(share of the faulty scenes, effect, its settings between two values). The other scenes are exact in that respect."""
FAULTY = 0.6
"""Share of the scenes that may have faults."""
WHOLE = frozenset({"quality"})
"""Settings that are whole numbers."""
DRESSED = 0.5
"""Share of the training scenes whose people wear and hold what captured people do."""
ASTRAY = 0.4
"""Share of the training scenes whose cameras stand by eye: rolled, and at heights and gaps of their own."""
LEANING = 0.35
"""Share of the training scenes whose cameras stand on a leaning arc, so that pairs run diagonally or upright, as
neighbours in rows above each other do: a person seen by such a pair lies across its rectified pictures, which are
turned upright by quarters (`network/model/quarters.py`) before they are looked at."""
LEAN = (15.0, 90.0)
"""Degrees by which an arc leans, to either side."""
GAP, WIDEST = (15.0, 60.0), 110.0
"""Degrees between neighbours on a leaning arc, and from the first of them to the last, at most."""
BELOW = frozenset({"background_room", "cast_shadow"})
"""What a leaning arc does without: some of its cameras look from under the floor."""
LONGEST = 3.0
"""Seconds into a motion that the first frame may lie."""
FRAME_RATE = 2.0
"""Frames a second: two frames of a scene show two poses."""


def training_scene(seed: int, frames: int, cameras: tuple[int, ...], size: int) -> Scene:
    """The scene of a seed: a ring of one of the given numbers of cameras, or a leaning arc of no more than as many, a
    held-out camera in every gap, pictures of `size` px square.

    Raises ValueError for a seed that is kept for measuring.
    """
    if not 0 <= seed < FIRST_KEPT_SEED:
        raise ValueError(
            f"training seed {seed}: 0-{FIRST_VALIDATION_SEED - 1} train, {FIRST_VALIDATION_SEED}-{FIRST_KEPT_SEED - 1}"
            " validate, and the rest is kept for measuring"
        )
    random = generator(seed, "training")
    motions = casting(seed).motions
    count = int(cameras[int(random.integers(len(cameras)))])
    motion = motions[-1] if seed >= FIRST_VALIDATION_SEED and seed % 2 else motions[int(random.integers(len(motions)))]
    # Validation is on exact captures, as the gates are; half of the training is.
    faulty = seed < FIRST_VALIDATION_SEED and random.random() < FAULTY
    effects: dict[str, Any] = {"ambient_occlusion": {}}
    for share, name, between in FAULTS:
        drawn = {key: float(random.uniform(*ends)) for key, ends in between.items()}
        if random.random() < share and faulty:
            effects[name] = {"switch": "on", **{k: round(v) if k in WHOLE else v for k, v in drawn.items()}}
    dressed = extras(random) if seed < FIRST_VALIDATION_SEED and random.random() < DRESSED else {}
    if dressed:  # what it is made of shows by what it mirrors
        effects["specular"] = {"switch": "on", "strength": float(random.uniform(0.5, 2.0))}
    astray = seed < FIRST_VALIDATION_SEED and random.random() < ASTRAY
    rig: dict[str, Any] = {
        "kind": "ring",
        "cameras": count,
        "radius": float(random.uniform(2.4, 6.0)),
        "height": float(random.uniform(0.6, 2.2)),
        "roll": float(random.uniform(-8.0, 8.0)) if astray else 0.0,
        "roll_spread": float(random.uniform(0.0, 6.0)) if astray else 0.0,
        "tilt": float(random.uniform(-12.0, 12.0)) if astray else 0.0,
        "jitter": float(random.uniform(0.0, 0.25)) if astray else 0.0,
        "start": float(random.uniform(0.0, 360.0)),
        "size": [size, size],
        "fill": float(random.uniform(0.72, 0.92)),
        "framing": "frames",
    }
    leaning = generator(seed, "leaning")
    if seed < FIRST_VALIDATION_SEED and leaning.random() < LEANING:
        rig |= _leaning(leaning, count)
        effects = {name: settings for name, settings in effects.items() if name not in BELOW}
    return Scene.model_validate(
        {
            "seed": seed,
            "frames": frames,
            "frame_rate": FRAME_RATE,
            "subject": {"heading": float(random.uniform(-180.0, 180.0)), **dressed},
            "motion": {
                "name": motion,
                "phase": float(random.uniform(0.0, LONGEST)),
                "speed": float(random.uniform(0.8, 1.2)),
            },
            "rig": rig,
            "held_out": rig["cameras"] - (rig["kind"] == "arc"),
            "effects": effects,
        }
    )


def _leaning(random: np.random.Generator, count: int) -> dict[str, Any]:
    """What of the rig is other on an arc of at most `count` cameras that leans."""
    gap = float(random.uniform(*GAP))
    cameras = min(count, max(3, 1 + int(WIDEST / gap)))
    lean = float(random.uniform(*LEAN)) * (1 if random.random() < 0.5 else -1)
    # By its height the person at rest: by what is seen of it from above the lens would be far too long.
    fill = float(random.uniform(0.65, 0.9))
    return {
        "kind": "arc",
        "cameras": cameras,
        "span": gap * (cameras - 1),
        "tilt": lean,
        "fill": fill,
        "framing": "rest",
    }
