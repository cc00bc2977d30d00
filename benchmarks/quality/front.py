"""What quality costs: named settings from cheap to dear, on simulated people that nothing was tuned on.

    python -m benchmarks.quality.front [--plain 9000,9003,9005] [--capture-like 9101,9102,9105] [--picture FILE.png]

One frame of each scene, 512 px, eight cameras on the plain ones. Of each setting: CPU seconds of all stages but the
measuring, and box PSNR and SSIM of two held-out cameras at full size; small pictures are enlarged. Means over the
scenes, and which of the settings no other one beats.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import Cell, film_cell
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.charts.style import FAINT, GREY, INK, RED, chart, heading, name_points, seconds_axis
from posegaussian.dags.diagnostics.held_out_quality import quality
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.dags.tradeoff.pareto import pareto

NONE, HULL, SWEEP = "network.weights=none", "depth.method=hull", "depth.method=sweep"
HALF, SMALLER = "frames.size=256", "frames.size=384"
CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "half hull": (HALF, HULL, NONE, "refinement.steps=0"),
    "half hull 20": (HALF, HULL, NONE, "refinement.steps=20"),
    "half sweep": (HALF, SWEEP, NONE, "refinement.steps=0"),
    "half sweep 20": (HALF, SWEEP, NONE, "refinement.steps=20"),
    "half sweep network 50": (HALF, SWEEP, "refinement.steps=50"),
    "3/4 sweep 20": (SMALLER, SWEEP, NONE, "refinement.steps=20"),
    "3/4 sweep network 20": (SMALLER, SWEEP, "refinement.steps=20"),
    "3/4 sweep network 50": (SMALLER, SWEEP, "refinement.steps=50"),
    "hull": (HULL, NONE, "refinement.steps=0"),
    "hull 20": (HULL, NONE, "refinement.steps=20"),
    "hull 50": (HULL, NONE, "refinement.steps=50"),
    "hull network": (HULL, "network.weights=fast", "refinement.steps=0"),
    "hull network 50": (HULL, "network.weights=fast", "refinement.steps=50"),
    "sgbm": ("depth.method=sgbm", NONE, "refinement.steps=0"),
    "sweep": (SWEEP, NONE, "refinement.steps=0"),
    "sweep 20": (SWEEP, NONE, "refinement.steps=20"),
    "sweep 50": (SWEEP, NONE, "refinement.steps=50"),
    "sweep network": (SWEEP, "refinement.steps=0"),
    "sweep network 20": (SWEEP, "refinement.steps=20"),
    "sweep network 50": (SWEEP, "refinement.steps=50"),
    "default": (),
    "default 200": ("refinement.steps=200", "refinement.worth=0"),
}
"""{name: settings}."""
PRESETS = {"half hull": "preview", "default": "balanced", "default 200": "dear"}
"""{name here: what `run --budget` calls it}."""
MEASURES = "metrics"
SEQUENCE = ("survey", "judge", "tracks", "people")
"""Stages that are done once a sequence, however many frames it has."""


def spent(context: Context) -> Counter[str]:
    """CPU seconds by stage of what these results came from; other settings have left theirs beside it."""
    found, left_out = Counter[str](), {MEASURES, *context.unneeded()}
    for task, receipt in Book.open(context).receipts.items():
        if task.stage not in left_out:
            found[task.stage] += receipt.facts["cpu_seconds"]
    return found


def measured(cell: Cell, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """One row a setting."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, held_out = film_cell(cell, folder)
        reference, _ = run_capture(folder, (held_out, *CANDIDATES["hull"]))
        for point in names:
            size = next((s.partition("=")[2] for s in CANDIDATES[point] if s in (HALF, SMALLER)), None)
            results, _ = run_capture(folder, (held_out, *CANDIDATES[point]), archive=size or "archive")
            seconds = spent(results.context)
            found = quality(results.context, reference.context if size else results.context)
            rows.append(
                {
                    "seed": cell.seed,
                    "settings": point,
                    "s a frame": sum(v for s, v in seconds.items() if s not in SEQUENCE) / cell.scene.frames,
                    "s a sequence": sum(v for s, v in seconds.items() if s in SEQUENCE),
                    "box psnr": found["psnr box"],
                    "box ssim": found["ssim box"],
                }
            )
            print(
                f"seed {cell.seed}, {point}: {rows[-1]['s a frame']:.1f} s, {rows[-1]['box psnr']:.2f} dB", flush=True
            )
    return rows


def mean(rows: list[dict[str, Any]], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """One row a setting, cheapest first."""
    keys = ("s a frame", "s a sequence", "box psnr", "box ssim")
    found: list[dict[str, Any]] = [
        {"settings": n, **{k: float(np.mean([r[k] for r in rows if r["settings"] == n])) for k in keys}} for n in names
    ]
    best = pareto([(r["s a frame"], -r["box psnr"]) for r in found])
    return sorted(({**r, "front": b} for r, b in zip(found, best, strict=True)), key=lambda r: r["s a frame"])


def draw(rows: list[dict[str, Any]], file: Path) -> None:
    """Write a PNG: box PSNR and SSIM against CPU seconds a frame, every setting named, presets as well, the front in
    red."""
    names = [f"{r['settings']} ({PRESETS[r['settings']]})" if r["settings"] in PRESETS else r["settings"] for r in rows]
    with chart(file, 11, 5.2) as figure:
        heading(figure, "What quality costs: simulated people at 512 px, means over scenes", weight="bold")
        for measure, axes in zip(("box psnr", "box ssim"), figure.subplots(1, 2), strict=True):
            points = [(r["s a frame"], r[measure]) for r in rows]
            best = pareto([(x, -y) for x, y in points])
            kept = [p for p, on in zip(points, best, strict=True) if on]
            axes.plot(*zip(*points, strict=True), "o", color=GREY)
            axes.plot(*zip(*sorted(kept), strict=True), "o-", color=RED)
            axes.set_title(measure)
            seconds_axis(axes, "CPU seconds a frame", [x for x, _ in points])
            axes.margins(0.12)
            name_points(axes, points, names, [INK if on else FAINT for on in best], size=7.5)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plain", type=seeds, default=(9000, 9003, 9005))
    parser.add_argument("--capture-like", type=seeds, default=(9101, 9102, 9105))
    parser.add_argument("--settings", nargs="+", choices=list(CANDIDATES), default=list(CANDIDATES))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--picture", type=Path, help="draw the table as a PNG")
    parser.add_argument("--publish", metavar="NAME", help="keep the table in benchmarks/results/NAME.json")
    a = parser.parse_args()
    names = tuple(a.settings)
    cells = [Cell(s, 8, frames=1) for s in a.plain]
    cells += [Cell(s, None, frames=1, scenes="capture_like") for s in a.capture_like]
    with ProcessPoolExecutor(a.processes) as pool:
        rows = [r for found in pool.map(partial(measured, names=names), cells) for r in found]
    means = mean(rows, names)
    if a.picture is not None:
        draw(means, a.picture)
    publish(a.publish, means, {"plain": list(a.plain), "capture_like": list(a.capture_like)})


if __name__ == "__main__":
    main()
