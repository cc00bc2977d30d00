"""Ours beside other methods on simulated people at 512 px, through the protocol of `posegaussian evaluate`.

    python -m benchmarks.quality.peers --folder /tmp/peers        both sets, 6 and 8 cameras, one frame
    python -m benchmarks.quality.peers --folder /tmp/peers --seeds 9000-9001 --cameras 8

The methods are recipes of `evaluate` (ours, hull, ibr, 3dgs, pose_off), and ours without refinement. Scenes are those
of `benchmarks.quality.views`, plain people (9000-9007) and scenes like captures (9100-9107), each with 6 and with 8
cameras, two held-out ones midway. Pictures are compared as they are: those of cameras that expose differently are not
brought to one light first, as `views` does it. Time is wall time of tasks a frame, measuring left out; what is made
once a sequence, whatever its frames (survey, the judge), stands beside it.

The first scene of each set comes with 6 and 8 cameras before the second one, so that `--scenes 4` has all parts. What
is done lies in the folder and is not computed again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.quality.cells import SCENES, UNREFINED, Cell
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.evaluation.evaluate import evaluate
from posegaussian.dags.evaluation.measured import MEAN
from posegaussian.dags.evaluation.methods import OURS, Method, chosen
from posegaussian.dags.evaluation.results import Result, overall
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.simulate import stage_scene
from posegaussian.dags.simulation.simulated_run import ARCHIVE, CAPTURE, NAME, film_capture, held_out_setting
from posegaussian.storage.archive.store import Archive

CAMERAS = (6, 8)
METHODS = (
    *chosen(OURS),
    Method("unrefined", "ours as it is set by default, without refinement", UNREFINED),
    *chosen("hull,ibr,3dgs,pose_off"),
)
COLUMNS = {
    "box psnr": ("psnr", "box", MEAN),
    "box ssim": ("ssim", "box", MEAN),
    "mask psnr": ("psnr", "mask", MEAN),
    "full psnr": ("psnr", "full", MEAN),
    "full ssim": ("ssim", "full", MEAN),
    "ms a frame": ("ms_a_frame", "", MEAN),
    "drawing ms": ("drawing", "", MEAN),
    "once s": ("once", "", MEAN),
    "optimised s": ("optimised", "", MEAN),
    "Gaussians": ("gaussians", "", MEAN),
}
"""{column of the table: number of `evaluate`}."""


def cells(wanted: Sequence[int], cameras: Sequence[int], size: int, frames: int) -> list[Cell]:
    """Scenes in their order: the n-th of each set, with each number of cameras, before the next."""
    sets = [[(name, s) for s in own if not wanted or s in wanted] for name, own in SCENES.items()]
    most = max(map(len, sets))
    order = [own[i] for i in range(most) for own in sets if i < len(own)]
    return [Cell(s, n, size=size, frames=frames, scenes=name) for name, s in order for n in cameras]


def evaluated(cell: Cell, folder: Path, settings: Sequence[str]) -> list[Result]:
    """Every method's numbers on a scene, filmed into `folder` where it is not there yet.

    Raises RuntimeError where a task of a method fails, and KeyboardInterrupt where it is interrupted.
    """
    staged = stage_scene(cell.scene, folder)
    own = ["run.scheduler=serial", held_out_setting(staged), *settings]
    session = Session(load_configuration(None, own, folder=folder), str(folder / ARCHIVE), Console(quiet=True))
    if not (folder / ARCHIVE).exists():
        film_capture(cell.scene, folder)
        of_it = session.configuration.for_sequence(NAME)
        register(
            Archive.open(session.archive_url, create=True),
            NAME,
            find_capture("images", folder / CAPTURE, [], of_it),
            of_it,
        )
    made = evaluate(session, [NAME], METHODS)
    if not made.results:
        raise KeyboardInterrupt
    if made.status:
        raise RuntimeError(f"a method failed on seed {cell.seed}: {[r.why for r in made.results if r.why]}")
    return [Result(f"{cell.seed}-{cell.cameras}", _part(cell), r.method, r.numbers, r.why) for r in made.results]


def _part(cell: Cell) -> str:
    return f"{cell.scenes}, {cell.cameras} cameras"


def table(results: Sequence[Result]) -> list[dict[str, Any]]:
    """A row a method and a set with a number of cameras: the mean over its scenes, and how many they are."""
    rows = []
    for part in dict.fromkeys(r.data_set for r in results):
        own = [r for r in results if r.data_set == part]
        scenes = len({r.sequence for r in own})
        for mean in overall(own):
            numbers = {c: mean.value(key) for c, key in COLUMNS.items()}
            told = mean.why or "run"
            rows.append({"scenes": part, "count": scenes, "method": mean.method, **numbers, "state": told})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="of captures and archives, kept")
    parser.add_argument("--seeds", type=seeds, default=(), help="default: those for reporting of both sets")
    parser.add_argument("--cameras", type=lambda text: tuple(int(n) for n in text.split(",")), default=CAMERAS)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--scenes", type=int, help="so many of them, the first ones; default: all")
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    a = parser.parse_args()
    every = cells(a.seeds, a.cameras, a.size, a.frames)[: a.scenes]
    results: list[Result] = []
    for i, cell in enumerate(every):
        came = evaluated(cell, a.folder / f"{cell.scenes}-{cell.seed}-{cell.cameras}", a.set)
        results += came
        print(f"\n{i + 1} of {len(every)}: {_part(cell)}, seed {cell.seed}", flush=True)
        for r in came:
            told = ", ".join(f"{c} {v:.4g}" for c, k in COLUMNS.items() if (v := r.value(k)) is not None)
            print(f"  {r.method}: {told or f'not run: {r.why}'}", flush=True)
    scenes = [{"scene": r.sequence, "method": r.method, **{c: r.value(k) for c, k in COLUMNS.items()}} for r in results]
    settings = {"size": a.size, "frames": a.frames, "set": a.set, "scenes": scenes}
    default = not a.seeds and a.cameras == CAMERAS and a.size == 512 and a.frames == 1 and not a.set
    publish("peers" if default else None, table(results), settings)


if __name__ == "__main__":
    main()
