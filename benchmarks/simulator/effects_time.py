"""What every effect of the simulator costs: alone on a plain scene, and what leaving it out of a scene with all of them
saves.

    python -m benchmarks.simulator.effects_time [--size 512] [--cameras 2] [--repeats 5]

CPU milliseconds of one thread for one frame of all cameras; scenes with and without an effect are timed in turns and
the median of the differences is told. Light is computed once a frame and shared by its cameras. Milliseconds a picture
are what `posegaussian simulate` shows in its plan.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

from benchmarks.report import publish
from posegaussian.stages.simulator.effects.registry import EFFECTS
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.setup import stage

FRAME = 3
"""A kicking leg is fast in this one."""


def scene(size: int, cameras: int, effects: dict[str, Any]) -> Scene:
    """One kick, filmed with some effects forced on."""
    return Scene.model_validate(
        {
            "seed": 1,
            "frames": 5,
            "motion": {"name": "kick"},
            "rig": {"cameras": cameras, "size": [size, size]},
            "effects": dict.fromkeys(effects, "on"),
        }
    )


def milliseconds(size: int, cameras: int, effects: list[str]) -> float:
    """CPU ms to film one frame with all cameras; clothes, textures and compiled kernels are made before."""
    take = stage(scene(size, cameras, dict.fromkeys(effects))).take
    take.times[:] = take.times[:, :1]
    take.prepare()
    start = time.process_time()
    for view in range(cameras):
        take.shoot(FRAME, view)
    return 1000 * (time.process_time() - start)


def added(size: int, cameras: int, without: list[str], with_: list[str], repeats: int) -> tuple[float, float]:
    """Median ms that the second scene takes more than the first, timed one right after the other;
    and of the second alone."""
    pairs = [(milliseconds(size, cameras, without), milliseconds(size, cameras, with_)) for _ in range(repeats)]
    return statistics.median(b - a for a, b in pairs), statistics.median(b for _, b in pairs)


def main() -> None:
    """Time plain against plain + each, and all - each against all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--cameras", type=int, default=2)
    parser.add_argument(
        "--repeats", type=int, default=5, help="of a pair with one effect; half as many of a pair with all"
    )
    given = parser.parse_args()
    names = [e.name for e in EFFECTS]
    milliseconds(64, 1, names)
    plain = added(given.size, given.cameras, [], [], given.repeats)[1]
    rows: list[dict[str, Any]] = [
        {
            "effect": "none: the plain picture",
            "ms a frame": plain,
            "ms a picture": plain / given.cameras,
            "declared": "",
            "left out of all, saves ms a frame": "",
        }
    ]
    for e in EFFECTS:
        alone, _ = added(given.size, given.cameras, [], [e.name], given.repeats)
        saved, everything = added(
            given.size, given.cameras, [n for n in names if n != e.name], names, (given.repeats + 1) // 2
        )
        rows.append(
            {
                "effect": e.name,
                "ms a frame": alone,
                "ms a picture": alone / given.cameras,
                "declared": e.milliseconds,
                "left out of all, saves ms a frame": saved,
            }
        )
    rows.append(
        {
            "effect": "all",
            "ms a frame": everything,
            "ms a picture": everything / given.cameras,
            "declared": "",
            "left out of all, saves ms a frame": everything - plain,
        }
    )
    publish("effects_time", rows, vars(given))


if __name__ == "__main__":
    main()
