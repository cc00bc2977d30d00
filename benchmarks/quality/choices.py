"""The judge's choice of a depth method against brute force: simulated people, filmed and run by the real pipeline.

    python -m benchmarks.quality.choices [--seeds 1-4] [--cameras 8,6] [--variant clean]

Each scene is run with every method, and once with `depth.method: auto`. A row has the box PSNR of the held-out pictures
by method, in dB, what the judge measured of each, what was chosen, what that loses against the best, and the CPU
seconds of the judge. The right choice is the best method or one within 0.1 dB of it.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import Cell, film_cell, pictures
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.contract.judged import DEPTH, mean_scores
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.depth.params import resolve_method

RIGHT = 0.1
"""dB that a right choice may lose."""


def row_of(cell: Cell, settings: tuple[str, ...]) -> dict[str, Any]:
    """One scene."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        motion, held_out = film_cell(cell, folder)
        found, seconds = run_capture(folder, (held_out, *settings))
        context = found.context
        chosen = resolve_method(context.settings.depth, context.facts).name
        noted = mean_scores(context.noted[DEPTH]) if DEPTH in context.noted else None
        measured = np.full(len(BY_PICTURES), np.nan) if noted is None else noted[:, 0]
        reached = {}
        for method in BY_PICTURES:
            results, _ = run_capture(folder, (held_out, f"depth.method={method}", *settings))
            reached[method] = pictures(results, cell)["box psnr"]
        shutil.rmtree(folder / "archive")
    return {
        "seed": cell.seed,
        "motion": motion,
        "cameras": cell.cameras,
        "variant": cell.variant,
        **reached,
        **{f"judged {m}": float(v) for m, v in zip(BY_PICTURES, measured, strict=True)},
        "chosen": chosen,
        "loses": max(reached.values()) - reached[chosen],
        "judge s": float(seconds["judge"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=(1, 2, 3, 4))
    parser.add_argument("--cameras", type=lambda text: tuple(int(n) for n in text.split(",")), default=(8, 6))
    parser.add_argument("--variant", default="clean")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    parser.add_argument("--publish", metavar="NAME", help="keep the table in benchmarks/results/NAME.json")
    a = parser.parse_args()
    rows = []
    for cameras in a.cameras:
        for seed in a.seeds:
            rows.append(row_of(Cell(seed, cameras, a.variant, a.size, frames=1), tuple(a.set)))
            print(
                " ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()),
                flush=True,
            )
    right = sum(r["loses"] <= RIGHT for r in rows)
    publish(a.publish, rows, {"seeds": list(a.seeds), "size": a.size, "set": a.set})
    print(f"right, or at most {RIGHT} dB lost: {right} of {len(rows)}")


if __name__ == "__main__":
    main()
