"""The pictures of docs/reference/simulator.md: everybody from the front and from behind, one person in every motion.

python -m benchmarks.simulator.cast_pictures      writes docs/reference/cast.png and docs/reference/motions.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import ROOT
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.subjects.splits import (
    FIRST_KEPT_SEED,
    FIRST_VALIDATION_SEED,
    KEPT_OUTFITS,
    KEPT_SUBJECTS,
    OPEN_OUTFITS,
    OPEN_SUBJECTS,
    VALIDATION_SUBJECT,
)

BACKGROUND = 60
"""sRGB byte of the grey behind."""
WEARERS = (
    *zip(OPEN_SUBJECTS, OPEN_OUTFITS, strict=True),
    *zip(KEPT_SUBJECTS, KEPT_OUTFITS, strict=True),
    (VALIDATION_SUBJECT, OPEN_OUTFITS[0]),
)
MOMENTS = {"stand": 0.0, "walk": 0.3, "wave": 1.2, "kick": 0.25, "spin": 0.6, "crossed_arms": 1.6, "crouch": 1.1}
"""Seconds into each motion at which it is most itself."""


def pictures(
    seed: int,
    person: str,
    outfit: str,
    motion: str,
    moment: float,
    azimuths: tuple[float, ...],
    size: tuple[int, int],
    fill: float,
) -> list[np.ndarray]:
    """[h, w, 3] sRGB before grey of one person at one moment, by cameras at these azimuths,
    degrees from straight ahead."""
    turn = np.radians(azimuths)
    focal = fill * size[1] * 5.0 / 1.9 / max(size)  # over the longer side, of what is 1.9 m high at 5 m
    cameras: list[dict[str, Any]] = [
        {
            "name": f"cam{i}",
            "position": [5 * float(np.cos(a)), 5 * float(np.sin(a)), 1.1],
            "look_at": [0, 0, 0.93],
            "focal": focal,
            "size": list(size),
        }
        for i, a in enumerate(turn)
    ]
    scene = Scene.model_validate(
        {
            "seed": seed,
            "frames": 1,
            "subject": {"person": person, "outfit": outfit, "heading": 0.0},
            "motion": {"name": motion, "phase": moment},
            "rig": {"kind": "list", "cameras": cameras},
            "held_out": 0,
            "effects": {"ambient_occlusion": {}, "cast_shadow": {}},
        }
    )
    take = stage(scene).take
    shots = [take.shoot(0, v) for v in range(len(cameras))]
    return [
        (s.color + (1 - s.true_mask[..., None] / 255.0) * BACKGROUND).clip(0, 255).round().astype(np.uint8)
        for s in shots
    ]


def seed_of(person: str) -> int:
    """A seed that may show the person."""
    return FIRST_KEPT_SEED if person in KEPT_SUBJECTS else FIRST_VALIDATION_SEED if person == VALIDATION_SUBJECT else 0


def main() -> None:
    """Draw both, write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "reference", help="that is there already")
    folder = parser.parse_args().folder
    people = [pictures(seed_of(p), p, o, "stand", 0.0, (25.0, 205.0), (130, 300), 0.9) for p, o in WEARERS]
    cast = np.vstack([np.hstack([pair[side] for pair in people]) for side in (0, 1)])
    motions = np.hstack(
        [
            pictures(0, OPEN_SUBJECTS[1], "stripes", name, moment, (35.0,), (210, 250), 0.86)[0]
            for name, moment in MOMENTS.items()
        ]
    )
    for name, picture in (("cast", cast), ("motions", motions)):
        file = folder / f"{name}.png"
        if not cv2.imwrite(str(file), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9]):
            raise SystemExit(f"{file} was not written; --folder names one that is there and takes files")


if __name__ == "__main__":
    main()
