"""What every effect of the simulator costs: alone on a plain scene, and what leaving it out of a scene with all of them saves.

    python -m benchmarks.effects_time [--size 512] [--cameras 4] [--repeats 3]

Seconds of CPU of one thread for one frame of all cameras, the least of some repeats; light is computed once a frame and
shared by its cameras. Milliseconds a picture are what `posegaussian simulate` shows in its plan.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from benchmarks.report import publish
from stages.capture.effects.registry import EFFECTS
from stages.capture.scene import Scene
from stages.capture.staging import stage

FRAME = 3
"""A kicking leg is fast in this one."""


def scene(size: int, cameras: int, effects: dict[str, Any]) -> Scene:
    """One kick, filmed with some effects forced on."""
    return Scene.model_validate({"seed": 1, "frames": 5, "motion": {"name": "kick"}, "rig": {"cameras": cameras, "size": [size, size]}, "effects": dict.fromkeys(effects, "on")})


def milliseconds(size: int, cameras: int, effects: list[str]) -> float:
    """CPU ms to film one frame with all cameras; clothes, textures and compiled kernels are made before."""
    take = stage(scene(size, cameras, dict.fromkeys(effects))).take
    take.times[:] = take.times[:, :1]
    take.prepare()
    start = time.process_time()
    for view in range(cameras):
        take.shoot(FRAME, view)
    return 1000 * (time.process_time() - start)


def main() -> None:
    """Time plain, plain + each, all, all - each, in turns, so that a busy moment does not fall on one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    names = [e.name for e in EFFECTS]
    sets = {("plain", ""): [], ("all", ""): names} | {("with", n): [n] for n in names} | {("without", n): [m for m in names if m != n] for n in names}
    least: dict[tuple[str, str], float] = {}
    milliseconds(64, 1, names)
    for _ in range(given.repeats):
        for key, effects in sets.items():
            least[key] = min(least.get(key, float("inf")), milliseconds(given.size, given.cameras, effects))
    plain, everything = least["plain", ""], least["all", ""]
    rows: list[dict[str, Any]] = [{"effect": "none: the plain picture", "ms a frame": plain, "ms a picture": plain / given.cameras, "declared": "", "left out of all, saves ms a frame": "", "saves %": ""}]
    for e in EFFECTS:
        alone, saved = least["with", e.name] - plain, everything - least["without", e.name]
        rows.append({"effect": e.name, "ms a frame": alone, "ms a picture": alone / given.cameras, "declared": e.milliseconds, "left out of all, saves ms a frame": saved, "saves %": 100 * saved / everything})
    rows.append({"effect": "all", "ms a frame": everything, "ms a picture": everything / given.cameras, "declared": "", "left out of all, saves ms a frame": everything - plain, "saves %": 100 * (1 - plain / everything)})
    publish("effects_time", rows, vars(given))


if __name__ == "__main__":
    main()
