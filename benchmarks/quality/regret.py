"""What the decisions about effects cost: on every scene each effect is turned against its decision, one at a time.

    python -m benchmarks.quality.regret                                        both reporting sets, shipped scenes
    python -m benchmarks.quality.regret --sets plain capture_like --seeds 1-8  tuning
    python -m benchmarks.quality.regret --sets shipped --scenes messy sparse_6

`posegaussian effects --regret` on simulated people, by the same code: box PSNR of held-out cameras in the middle of
gaps, each channel's light fitted, and CPU seconds a frame. A line a scene: what the decisions lose against the best of
what was tried (each effect turned, all together that gain by themselves, everything on), which that is, and what
"everything on" gains and takes besides. Then a line an effect: how often it is on and off, and what that costs. An
effect that cannot be anything else on a scene is not counted there.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import SCENES, UNREFINED, Cell
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.regret.regret import CLEAR, Regret, measured
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.shipped import scene_file, shipped_scenes
from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.dags.simulation.simulated_run import NAME, film_capture, held_out_setting, registered
from posegaussian.stages.simulator.scene import Scene

SHIPPED = "shipped"
MEAN, WORST = 0.1, 0.3
"""dB that decisions may cost: the mean over scenes, and the worst of them."""


@dataclass(frozen=True)
class Filmed:
    """One scene of a set."""

    set: str
    name: str
    scene: Scene


def chosen(a: argparse.Namespace) -> Iterator[Filmed]:
    """The scenes, made small."""
    for name in a.sets:
        if name == SHIPPED:
            for shipped in a.scenes or shipped_scenes():
                yield Filmed(SHIPPED, shipped, small(read_scene(scene_file(shipped)), a.size, a.frames))
        else:
            for seed in a.seeds or SCENES[name]:
                cameras = a.cameras if name == "plain" else None
                yield Filmed(name, str(seed), Cell(seed, cameras, size=a.size, frames=a.frames, scenes=name).scene)


def small(scene: Scene, size: int, frames: int) -> Scene:
    """A shipped scene whose pictures have a longest side of `size` px, its first frames, two cameras held out."""
    given = scene.model_dump()
    wide, high = given["rig"]["size"]
    given["rig"]["size"] = [round(side * size / max(wide, high)) for side in (wide, high)]
    held_out = given["held_out"]
    kept = min(held_out, 2) if isinstance(held_out, int) else held_out[:2]
    return Scene.model_validate({**given, "frames": min(frames, scene.frames), "held_out": kept or 1})


def regret_of(filmed: Filmed, settings: tuple[str, ...]) -> Regret:
    """Film the scene, turn its effects."""
    with tempfile.TemporaryDirectory() as folder:
        staged, _ = film_capture(filmed.scene, Path(folder))
        session = registered(Path(folder), (held_out_setting(staged), *settings))
        return measured(session, NAME, pairs=False, repeats=1)


def scene_row(filmed: Filmed, found: Regret) -> dict[str, Any]:
    """What decisions cost on a scene."""
    best = found.best if found.best.gain >= CLEAR else None
    return {
        "set": filmed.set,
        "scene": filmed.name,
        "cameras": filmed.scene.rig.cameras,
        "as decided dB": found.psnr,
        "regret dB": best.gain if best else 0.0,
        "by turning": " + ".join(best.names) if best else "",
        "CPU s a frame": found.seconds,
        "deciding CPU s": found.deciding,
        "everything on dB": found.everything.gain,
        "everything on CPU s": found.everything.seconds,
    }


def effect_rows(found: Sequence[tuple[Filmed, Regret]]) -> list[dict[str, Any]]:
    """One row an effect and state: on how many scenes it was so, and what the other way gains in dB and takes."""
    cases: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for filmed, regret in found:
        for switch in regret.switches:
            turned = regret.singles[switch.name]
            told = f"{filmed.name} {switch.measured}".strip()
            cases.setdefault((switch.name, switch.decided), []).append((turned.gain, turned.seconds, told))
    return [
        {
            "effect": name,
            "decided": state,
            "scenes": len(of),
            "the other way dB": float(np.mean([gain for gain, _, _ in of])),
            "CPU s a frame": float(np.mean([seconds for _, seconds, _ in of])),
            "costs dB": float(np.mean([max(0.0, gain) for gain, _, _ in of])),
            "at most dB": max(0.0, max(of)[0]),
            "on scene, measured": max(of)[2] if max(of)[0] >= CLEAR else "",
        }
        for (name, state), of in sorted(cases.items())
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", choices=(*SCENES, SHIPPED), nargs="+", default=[*SCENES, SHIPPED])
    parser.add_argument("--seeds", type=seeds, default=(), help="default: those for reporting")
    parser.add_argument("--scenes", nargs="+", choices=shipped_scenes(), help="of the shipped ones; default: all")
    parser.add_argument("--cameras", type=int, default=6, help="of plain scenes")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    parser.add_argument("--publish", metavar="NAME", help="keep the tables in benchmarks/results/NAME.json")
    a = parser.parse_args()
    every, found = list(chosen(a)), []
    with ProcessPoolExecutor(a.processes, initializer=limit, initargs=(1,)) as pool:
        for filmed, regret in zip(
            every, pool.map(partial(regret_of, settings=(*UNREFINED, *a.set)), every), strict=True
        ):
            found.append((filmed, regret))
            row = scene_row(filmed, regret)
            print(f"{filmed.set} {filmed.name}: regret {row['regret dB']:.2f} dB {row['by turning']}", flush=True)
            for switch in regret.switches:
                turned = regret.singles[switch.name]
                print(
                    f"    {switch.name} {switch.decided} ({switch.measured}): the other way {turned.gain:+.2f} dB,"
                    f" {turned.seconds:+.2f} s",
                    flush=True,
                )
    rows = [scene_row(filmed, regret) for filmed, regret in found]
    given = {k: v for k, v in vars(a).items() if k not in ("processes", "publish")}
    publish(None, effect_rows(found), given)
    publish(a.publish, rows, {**given, "effects": effect_rows(found)})
    for told, value, bound in (
        ("mean", float(np.mean([r["regret dB"] for r in rows])), MEAN),
        ("worst", max(r["regret dB"] for r in rows), WORST),
    ):
        print("holds  " if value <= bound else "FAILS  ", f"{told} regret {value:.2f} dB of at most {bound}")


if __name__ == "__main__":
    main()
