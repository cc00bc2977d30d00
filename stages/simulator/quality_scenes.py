"""Scenes on which quality is measured: the same people, motions and cameras for everybody, in clean and spoilt
variants.

`ablation_scene` has those on which an ablation runs the pipeline; they are for validation, so that what is reported
stays unseen.

    scene = benchmark_scene(9000, cameras=8, variant="noise_gain")
    staged = stage(scene)                      # posegaussian.stages.simulator.setup
    shot = staged.take.shoot(frame, view)      # views from staged.sources on are held out
    staged.written                             # the cameras as a program under test knows them; staged.take.rig are the
    true ones
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.subjects.motion_names import VALIDATION_MOTION
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED, FIRST_VALIDATION_SEED

TUNING_SEEDS, REPORTING_SEEDS = range(1, 100), range(9000, 9008)
"""Tune on the former as often as you like; run the latter for figures that are published."""
MOTIONS = ("walk", "kick", "crossed_arms", "crouch")
_PHASES = {"walk": (0.0, 1.06), "kick": (0.05, 0.40), "crossed_arms": (0.0, 2.8), "crouch": (1.0, 1.4)}
"""Seconds into the motion between which the first frame lies; a crouch is low."""
FRAME_RATE = 10.0
"""Three frames at this rate differ as much as three of ten do at 30."""

VARIANTS: dict[str, Mapping[str, Any]] = {
    "clean": {},
    "noise_gain": {
        "effects": {
            "sensor_noise": {"electrons": 4400, "read": 6},
            "camera_gain": {"exposure": 0.0286, "white_balance": 0.0},
        }
    },
    "specular": {"effects": {"specular": {"strength": 2.0}}},
    "calibration_0.3": {"effects": {"calibration_error": {"pixels": 0.3}}},
    "calibration_1": {"effects": {"calibration_error": {"pixels": 1.0}}},
    "mask_plus_1": {"effects": {"mask_error": {"grow": 1.0}}},
    "mask_minus_1": {"effects": {"mask_error": {"grow": -1.0}}},
    "messy": {
        "rig": {"jitter": 0.06, "roll": 3.0},
        "effects": {
            "lens_distortion": {"k1": -0.09, "k2": 0.02}, "calibration_error": {"pixels": 0.3, "metres": 0.001},
            "time_offset": {"frames": 0.033},
            "cloth_motion": {}, "motion_blur": {"shutter": 0.1}, "cast_shadow": {}, "specular": {},
            "background_room": {"side": 9.0}, "vignetting": {"corner": 0.2},
            "camera_gain": {"exposure": 0.08, "white_balance": 0.02}, "sensor_noise": {"electrons": 6000},
            "jpeg": {"quality": 88},
            "mask_error": {"wobble": 0.7}, "joint_noise": {"pixels": 4.0, "dropouts": 0.05, "outliers": 0.01},
        },
    },
}  # fmt: skip
"""{name: what it lays over the clean scene}. Noise is 2 of 255 steps at mid-grey, gain 2 %; `messy` is the scene
file of that name."""


def benchmark_scene(
    seed: int, cameras: int = 8, size: int = 512, frames: int = 3, variant: str = "clean", held_out: int = 2
) -> Scene:
    """The scene of one seed: `cameras` on a ring, `held_out` ones in the middle of gaps, `size` px square, and a few
    frames.

    The person fills at least 86 % of the height of every picture; who it is, what is worn, the motion, its phase and
    the heading follow from the seed, and are the same for every number of cameras and every variant. Over four seeds
    each motion comes once, over the reporting seeds each kept subject and outfit twice. Raises ValueError for a seed
    that is for neither tuning nor reporting, and for an unknown variant.
    """
    if seed not in TUNING_SEEDS and seed not in REPORTING_SEEDS:
        raise ValueError(
            f"benchmark seed {seed}: {TUNING_SEEDS.start}-{TUNING_SEEDS.stop - 1} are for tuning,"
            f" {REPORTING_SEEDS.start}-{REPORTING_SEEDS.stop - 1} for reporting"
        )
    if variant not in VARIANTS:
        raise ValueError(f"there is no benchmark variant {variant!r}; there are {', '.join(VARIANTS)}")
    motion = MOTIONS[(seed + 2 * (seed // 4)) % len(MOTIONS)]
    random, spoilt = generator(seed, "benchmark"), VARIANTS[variant]
    return Scene.model_validate(
        {
            "seed": seed,
            "frames": frames,
            "frame_rate": FRAME_RATE,
            "subject": {"heading": float(random.uniform(-180.0, 180.0))},
            "motion": {"name": motion, "phase": float(random.uniform(*_PHASES[motion]))},
            "rig": {
                "kind": "ring",
                "cameras": cameras,
                "radius": 5.0,
                "height": 1.0,
                "size": [size, size],
                "fill": 0.86,
                "framing": "frames",
                **spoilt.get("rig", {}),
            },
            "held_out": held_out,
            "effects": {"ambient_occlusion": {}, **spoilt.get("effects", {})},
        }
    )


VALIDATION_PHASES = {
    VALIDATION_MOTION: (0.35, 0.55),
    "walk": (0.0, 1.06),
    "kick": (0.0, 0.1),
    "crossed_arms": (0.0, 2.8),
}
"""{motion of an ablation: seconds into it between which the first frame lies}:
where arm and leg are about to be fastest."""


def ablation_scene(
    seed: int, cameras: int, size: int, frames: int, frame_rate: float, effects: Mapping[str, Any]
) -> Scene:
    """A sequence that nothing was trained on: a ring of an even number of cameras, and two held-out ones in the middle
    of opposite gaps.

    The person, the motion, its phase and the heading follow from the seed, and the held-out cameras are the same for
    every number of cameras, so that pictures of different rings compare. The subject is never trained on, and over four
    seeds each motion comes once; the first one is never trained on either. `effects` are laid over the clean scene.
    Raises ValueError for a seed that is not for validation, and for an odd number of cameras.
    """
    if not FIRST_VALIDATION_SEED <= seed < FIRST_KEPT_SEED:
        raise ValueError(
            f"seed {seed} of an ablation's sequence: those for validation are"
            f" {FIRST_VALIDATION_SEED}-{FIRST_KEPT_SEED - 1}"
        )
    if cameras % 2:
        raise ValueError(f"{cameras} cameras: an even number has opposite gaps")
    motion = tuple(VALIDATION_PHASES)[seed % len(VALIDATION_PHASES)]
    random = generator(seed, "ablation")
    # The lens follows from the subject at rest (`framing: rest`):
    # framed in motion, it would depend on the cameras there are.
    rig = {
        "kind": "ring",
        "cameras": cameras,
        "radius": 5.0,
        "height": 1.0,
        "start": -180.0 / cameras,
        "size": [size, size],
        "fill": 0.78,
    }
    return Scene.model_validate(
        {
            "seed": seed,
            "frames": frames,
            "frame_rate": frame_rate,
            "subject": {"heading": float(random.uniform(-180.0, 180.0))},
            "motion": {"name": motion, "phase": float(random.uniform(*VALIDATION_PHASES[motion]))},
            "rig": rig,
            "held_out": 2,
            "effects": {"ambient_occlusion": {}, **effects},
        }
    )
