"""Scenes that the network is trained on: people, motions, cameras and faults, all from the number of the scene.

Nobody who is kept for measuring plays here (`posegaussian.stages.simulator.subjects.splits`): seeds below 8000 train,
seeds from 8000 on validate, with a subject and a motion that training never shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED, FIRST_VALIDATION_SEED, casting

FAULTS: tuple[tuple[float, Mapping[str, Any]], ...] = (
    (0.5, {"sensor_noise": {"electrons": 5000, "read": 5}, "camera_gain": {"exposure": 0.03, "white_balance": 0.01}}),
    (0.3, {"specular": {"strength": 1.0}}),
    (0.3, {"calibration_error": {"pixels": 0.3}}),
    (0.3, {"mask_error": {"wobble": 0.5}}),
    (0.3, {"cast_shadow": {}}),
)
"""(share of the scenes, what it lays over them). The other scenes are exact in that respect."""
LONGEST = 3.0
"""Seconds into a motion that the first frame may lie."""
FRAME_RATE = 2.0
"""Frames a second: two frames of a scene show two poses."""


def training_scene(seed: int, frames: int, cameras: tuple[int, ...], size: int) -> Scene:
    """The scene of a seed: a ring of one of the given numbers of cameras, a held-out camera in every gap, pictures of
    `size` px square.

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
    faulty = seed < FIRST_VALIDATION_SEED and random.random() < 0.5
    effects: dict[str, Any] = {"ambient_occlusion": {}}
    for share, fault in FAULTS:
        if random.random() < share and faulty:
            effects |= fault
    return Scene.model_validate(
        {
            "seed": seed,
            "frames": frames,
            "frame_rate": FRAME_RATE,
            "subject": {"heading": float(random.uniform(-180.0, 180.0))},
            "motion": {
                "name": motion,
                "phase": float(random.uniform(0.0, LONGEST)),
                "speed": float(random.uniform(0.8, 1.2)),
            },
            "rig": {
                "kind": "ring",
                "cameras": count,
                "radius": float(random.uniform(3.0, 6.0)),
                "height": float(random.uniform(0.8, 1.6)),
                "start": float(random.uniform(0.0, 360.0)),
                "size": [size, size],
                "fill": float(random.uniform(0.72, 0.92)),
                "framing": "frames",
            },
            "held_out": count,
            "effects": effects,
        }
    )
