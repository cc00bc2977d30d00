"""Throughput of a night: frames an hour of the real pipeline, by number of workers, and the memory of its processes.

    python -m benchmarks.pipeline.night [--frames 200] [--cameras 8 16] [--sizes 512 1080p] [--workers 1 2]
        [--repeats 3] [--seed 1] [--set depth.method=hull ...]

A simulated person filmed by cameras on a ring, two held out and drawn in every frame, everything as it is set by
default, one thread a task: `posegaussian run` from an empty archive to its end, starting and survey included, so that
few frames make fewer an hour than many. Numbers of workers take turns, forwards and backwards, each with a run in every
repeat; figures are medians, and `times` is the median over repeats of frames an hour beside those of the first number
of workers in the same repeat. `memory` is the peak of all processes together. `others` says how many cores other work
took meanwhile: near 0, or the machine was not quiet. Each cell is run once before, on two frames that do not count, so
that nothing is compiled in a run that does.

By default that is twelve runs of 200 frames with one worker and twelve with two: name what you want of it. Runs of
fewer frames, or under other settings, are printed and not kept.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.processes import Taken, watched
from benchmarks.report import publish, show
from posegaussian.dags.simulation.simulated_run import ARCHIVE, film_capture, held_out_setting, registered
from posegaussian.stages.simulator.quality_scenes import benchmark_scene
from posegaussian.stages.simulator.scene import Scene

SIZES = {"512": (512, 512), "1080p": (1920, 1080)}
"""{name: width, height of the pictures, px}."""
CLI = [sys.executable, "-m", "posegaussian.dags.cli.app"]
NIGHT = 200
"""Frames, at least, beside which starting and survey weigh little."""
TWO_FRAMES = ("frames.range=0:2",)


@dataclass(frozen=True)
class Cell:
    """What is filmed."""

    seed: int
    cameras: int
    size: str
    """Name in `SIZES`."""
    frames: int

    @property
    def scene(self) -> Scene:
        """A benchmark's scene in these pictures."""
        scene = benchmark_scene(self.seed, self.cameras, frames=self.frames)
        return scene.model_copy(update={"rig": scene.rig.model_copy(update={"size": SIZES[self.size]})})


def measured(cell: Cell, workers: Sequence[int], repeats: int, settings: tuple[str, ...]) -> dict[int, list[Taken]]:
    """{number of workers: what each of its runs took}, in the order of the repeats."""
    found: dict[int, list[Taken]] = {n: [] for n in workers}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        staged, _ = film_capture(cell.scene, folder)
        given = (held_out_setting(staged), *settings)
        run(folder, workers[0], (*given, *TWO_FRAMES))
        for repeat in range(repeats):
            for n in workers if repeat % 2 == 0 else reversed(workers):
                found[n].append(run(folder, n, given))
    return found


def run(folder: Path, workers: int, settings: tuple[str, ...]) -> Taken:
    """The capture of a folder, from an empty archive, which is removed."""
    registered(folder, settings)
    chosen = (*settings, "run.scheduler=local", f"run.workers={workers}", "run.threads=1")
    words = [w for s in chosen for w in ("--set", s)]
    taken = watched([*CLI, "run", "--archive", str(folder / ARCHIVE), *words], folder)
    shutil.rmtree(folder / ARCHIVE)
    return taken


def rows(cell: Cell, found: Mapping[int, Sequence[Taken]]) -> list[dict[str, Any]]:
    """A row a number of workers; the first one is what the others are compared with."""
    first = next(iter(found.values()))
    return [
        {
            "cameras": cell.cameras,
            "size": cell.size,
            "frames": cell.frames,
            "workers": n,
            "frames an hour": 3600 * cell.frames / _median([t.seconds for t in taken]),
            "times": _median([a.seconds / b.seconds for a, b in zip(first, taken, strict=True)]),
            "CPU s a frame": _median([t.cpu for t in taken]) / cell.frames,
            "memory MB": max(t.memory for t in taken),
            "others cores": _median([t.others for t in taken]),
        }
        for n, taken in found.items()
    ]


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a cell as it is done, and keep a night's."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=NIGHT)
    parser.add_argument("--cameras", type=int, nargs="+", default=[8, 16])
    parser.add_argument("--sizes", nargs="+", choices=tuple(SIZES), default=list(SIZES))
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    given = parser.parse_args(arguments)
    table: list[dict[str, Any]] = []
    for size in given.sizes:
        for cameras in given.cameras:
            cell = Cell(given.seed, cameras, size, given.frames)
            found = rows(cell, measured(cell, given.workers, given.repeats, tuple(given.set)))
            show(found)
            table += found
    whole = given.frames >= NIGHT and not given.set
    settings = {k: v for k, v in vars(given).items() if k != "set"}
    publish("night" if whole else None, table, settings, shown=False)


if __name__ == "__main__":
    main()
