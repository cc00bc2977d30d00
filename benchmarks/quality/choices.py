"""The judge's choices against brute force: simulated people, filmed and run by the real pipeline.

    python -m benchmarks.quality.choices [depth | network] [--seeds 1-4] [--cameras 8,6] [--scenes plain]
    [--variant clean]

Each scene is run with every candidate, and once with `auto`, all else as a run sets it by itself: finished pictures
count, while the judge looks at unrefined ones. A row has the box PSNR of the held-out pictures by candidate, in dB,
what the judge measured of each, what was chosen, what that loses against the best, and the CPU seconds of the judge.
The right choice is the best candidate or one within 0.1 dB of it. `--scenes capture_like` films scenes that are like
captures.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import SCENES, Cell, film_cell, pictures
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.planning.context import Context
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.contract.judged import DEPTH, LEARNED, NONE, mean_of_asked
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.network.choice import CANDIDATES, weights_choice

RIGHT = 0.1
"""dB that a right choice may lose."""


@dataclass(frozen=True)
class Judged:
    """A choice of the judge."""

    setting: str
    candidates: tuple[str, ...]
    array: str
    """What the judge noted."""
    chosen: Callable[[Context], str]


CHOICES = {
    "depth": Judged(
        "depth.method",
        BY_PICTURES,
        DEPTH,
        lambda c: resolve_method(c.settings.depth, c.facts).name,
    ),
    "network": Judged("network.weights", CANDIDATES, LEARNED, lambda c: weights_choice(c.settings.network, c.facts)[0]),
}


def row_of(choice: Judged, cell: Cell, settings: tuple[str, ...]) -> dict[str, Any]:
    """One scene."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        motion, held_out = film_cell(cell, folder)
        settings = (held_out, *settings)
        found, seconds = run_capture(folder, (*settings, f"{choice.setting}=auto"))
        context = found.context
        chosen = choice.chosen(context)
        noted = mean_of_asked(context.noted[choice.array]) if choice.array in context.noted else None
        measured = np.full(len(choice.candidates), np.nan) if noted is None else noted[:, 0]
        measured = np.where(measured == NONE, np.nan, measured)
        reached = {}
        for candidate in choice.candidates:
            results, _ = run_capture(folder, (*settings, f"{choice.setting}={candidate}"))
            reached[candidate] = pictures(results, cell)["box psnr"]
        shutil.rmtree(folder / "archive")
    return {
        "seed": cell.seed,
        "scenes": cell.scenes,
        "motion": motion,
        "cameras": cell.scene.rig.cameras,
        "variant": cell.variant,
        **reached,
        **{f"judged {m}": float(v) for m, v in zip(choice.candidates, measured, strict=True)},
        "chosen": chosen,
        "loses": max(reached.values()) - reached[chosen],
        "judge s": float(seconds["judge"]),
    }


def _counts(text: str) -> tuple[int | None, ...]:
    return tuple(None if n == "own" else int(n) for n in text.split(","))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("choice", nargs="?", choices=list(CHOICES), default="depth")
    parser.add_argument("--seeds", type=seeds, default=(1, 2, 3, 4))
    parser.add_argument("--cameras", type=_counts, default=(8, 6), help="numbers, or `own`: as many as a scene has")
    parser.add_argument("--scenes", choices=list(SCENES), default="plain")
    parser.add_argument("--variant", default="clean")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    parser.add_argument("--publish", metavar="NAME", help="keep the table in benchmarks/results/NAME.json")
    a = parser.parse_args()
    rows = []
    for cameras in a.cameras:
        for seed in a.seeds:
            cell = Cell(seed, cameras, a.variant, a.size, frames=1, scenes=a.scenes)
            rows.append(row_of(CHOICES[a.choice], cell, tuple(a.set)))
            print(
                " ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()),
                flush=True,
            )
    right = sum(r["loses"] <= RIGHT for r in rows)
    publish(a.publish, rows, {"choice": a.choice, "seeds": list(a.seeds), "size": a.size, "set": a.set})
    print(f"right, or at most {RIGHT} dB lost: {right} of {len(rows)}")


if __name__ == "__main__":
    main()
