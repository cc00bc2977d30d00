"""How cameras are held and stand: the same people filmed by rigs that are rolled, tilted and stacked.

    python -m benchmarks.quality.held                                    the published figures: seeds 9000 and 9001
    python -m benchmarks.quality.held --seeds 3 --rigs ring              tuning

A ring of eight cameras, level and rolled: all by 90, 45 or 27 degrees, each by a random angle. An arc of four over 60
degrees, level, tilted by 45 degrees as on one bar (the pictures with it), the same with level pictures, and stacked
upright, with level pictures and with pictures on their side. A ring of twelve, and as many and other numbers in stacks
of two above each other, which stand opposite one another. Focal length, people and held-out cameras are the same for
all rigs of a kind, and held-out cameras are level, so their pictures and boxes are the same too: two in the middle of
gaps of a ring and between stacks, one in the middle of the arc.

One frame of each person, 320 px square. A ring that is rolled sees what it sees level. An arc that is stacked sees
something else of the person: what that alone costs is the row with true depth, refined where the default is.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.quality.cells import DEFAULT, FLOOR, Cell, pictures
from benchmarks.quality.views import means, seeds
from benchmarks.report import publish
from posegaussian.dags.simulation.simulated_run import depths, film_capture, held_out_setting, run_capture
from posegaussian.stages.simulator.quality_scenes import benchmark_scene
from posegaussian.stages.simulator.scene import Scene

RADIUS, HEIGHT, FILL = 5.0, 1.0, 0.7
"""Of the ring: metres and the share of the picture's height that the person at rest fills, upright on the diagonal
too."""
_STACK = {"kind": "stereo", "baseline": 1.4, "tilt": 90, "start": 0}
RIGS: dict[str, dict[str, Mapping[str, Any]]] = {
    "ring": {
        "level": {},
        "rolled by 90": {"roll": 90},
        "rolled by 45": {"roll": 45},
        "rolled by 27": {"roll": 27},
        "each rolled at random": {"roll_spread": 180},
    },
    "arc": {
        "level": {},
        "tilted by 45": {"tilt": 45, "roll": 45},
        "tilted by 45, pictures level": {"tilt": 45},
        "stacked": {"tilt": 90},
        "stacked, rolled by 90": {"tilt": 90, "roll": 90},
    },
    "stacks": {
        "level": {},
        "four of two": {**_STACK, "cameras": 8, "start": -15},
        "six of two": {**_STACK, "cameras": 12},
        "eight of two": {**_STACK, "cameras": 16, "start": 7.5},
    },
}
"""{kind: {name: how it is held}}."""
KINDS: dict[str, Mapping[str, Any]] = {
    "ring": {"kind": "ring", "cameras": 8},
    "arc": {"kind": "arc", "cameras": 4, "span": 60},
    "stacks": {"kind": "ring", "cameras": 12, "start": 15},
}
MIDDLES = {"ring": (22.5, 202.5), "arc": (0.0,), "stacks": (30.0, 210.0)}
"""Degrees around of the held-out cameras."""
TRUTH, REFINED_TRUTH = "truth", "truth, refined"
METHODS = ("sgbm", "sweep", TRUTH, DEFAULT, REFINED_TRUTH)
SETTINGS = {DEFAULT: (), REFINED_TRUTH: ("network.weights=none", "depth.method=truth")}
REFERENCE = {DEFAULT: REFINED_TRUTH}
"""{method: what true depth loses by the same is told by}, where that is not `truth`: the default is refined."""
MAY_LOSE = 0.2
"""dB of box PSNR that any way to hold cameras may cost."""
SHOWN = ("rig", "held", "depth", "box psnr", "against level", "box ssim", "EPE", "EPE median", "coverage")


def scene(seed: int, kind: str, held: Mapping[str, Any], size: int) -> Scene:
    """One frame of the benchmark's person of that seed before a rig."""
    base = benchmark_scene(seed, 8, size, 1).model_dump(exclude={"rig", "held_out"})
    lens = {"size": [size, size], "fill": FILL}
    middles = [
        {
            "name": f"mid{i:02d}",
            "position": [RADIUS * math.cos(math.radians(a)), RADIUS * math.sin(math.radians(a)), HEIGHT],
            **lens,
        }
        for i, a in enumerate(MIDDLES[kind])
    ]
    rig = {**KINDS[kind], "radius": RADIUS, "height": HEIGHT, **lens, **held}
    return Scene.model_validate({**base, "rig": rig, "held_out": middles})


def measured(
    seed: int, kind: str, held: str, size: int, methods: Sequence[str], settings: tuple[str, ...]
) -> Iterator[dict[str, Any]]:
    """One row a depth method."""
    with tempfile.TemporaryDirectory() as folder:
        staged, _ = film_capture(scene(seed, kind, RIGS[kind][held], size), Path(folder))
        cell = Cell(seed, staged.sources, size=size, frames=1)
        for method in methods:
            chosen = SETTINGS.get(method, (*FLOOR, f"depth.method={method}"))
            results, _ = run_capture(Path(folder), (held_out_setting(staged), *chosen, *settings))
            yield {
                "seed": seed, "rig": kind, "held": held, "depth": method, **pictures(results, cell), **depths(results)
            }  # fmt: skip


def against_level(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means by rig and method, with the dB against the level rig of the kind."""
    found = means(rows, "rig", "held", "depth")
    level = {(r["rig"], r["depth"]): r["box psnr"] for r in found if r["held"] == "level"}
    return [{**r, "against level": r["box psnr"] - level[r["rig"], r["depth"]]} for r in found]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=(9000, 9001))
    parser.add_argument("--size", type=int, default=320)
    parser.add_argument("--rigs", choices=tuple(RIGS), nargs="+", default=list(RIGS))
    parser.add_argument(
        "--methods", choices=METHODS, nargs="+", default=list(METHODS), help="with true depth to say what holds"
    )
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    a = parser.parse_args()
    rows = []
    for seed in a.seeds:
        for kind in a.rigs:
            for held in RIGS[kind]:
                for row in measured(seed, kind, held, a.size, a.methods, tuple(a.set)):
                    rows.append(row)
                    print(
                        f"seed {seed}, {kind} {held}, {row['depth']}: box {row['box psnr']:.2f} dB /"
                        f" {row['box ssim']:.3f}, EPE {row['EPE']:.2f} px",
                        flush=True,
                    )
    table = against_level(rows)
    published = (
        a.seeds == parser.get_default("seeds")
        and a.size == 320
        and not a.set
        and a.rigs == list(RIGS)
        and a.methods == list(METHODS)
    )
    publish(
        "quality_held" if published else None,
        [{k: r[k] for k in SHOWN} for r in table],
        {"seeds": list(a.seeds), "size": a.size},
    )
    against = {(r["rig"], r["held"], r["depth"]): r["against level"] for r in table}
    for r in table:
        truth = against.get((r["rig"], r["held"], REFERENCE.get(r["depth"], TRUTH)))
        if r["depth"] not in (TRUTH, REFINED_TRUTH) and r["held"] != "level" and truth is not None:
            loss = r["against level"] - min(truth, 0.0)
            print(
                "holds  " if loss >= -MAY_LOSE else "FAILS  ",
                f"{r['rig']} {r['held']}, {r['depth']}: {r['against level']:+.2f} dB, {truth:+.2f} with true depth",
            )


if __name__ == "__main__":
    main()
