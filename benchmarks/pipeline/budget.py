"""What is lost with fewer Gaussians: held-out views drawn from a budget of those that `export --splats` writes.

    python -m benchmarks.pipeline.budget                                       the published figures
    python -m benchmarks.pipeline.budget --scenes capture_like --seeds 2 --budgets 0.1

One frame of simulated people at 384 px, eight cameras or those of a scene like a capture, two held out, depth by sweep,
no network. The Gaussians of all source views are drawn from all sides as they are exported, without retouches: all of
them, merged to a budget (posegaussian/stages/splatting/budget.py), and a random choice of as many, enlarged along the
surface so that their area stays. PSNR in the subject's box, mean of the two held-out pictures; `through` is the share
of light that passes inside the subject's mask. Seconds are CPU seconds of the merging, on one thread.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.quality.cells import FLOOR, SCENES, Cell, film_cell
from benchmarks.quality.light import fitted
from benchmarks.quality.views import means, seeds
from benchmarks.refinement.gain import one_thread
from benchmarks.report import publish, show
from posegaussian.dags.export.splats import frame_gaussians
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.splatting.budget import within_budget
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.masks import foreground

CELLS = (("plain", 1), ("plain", 2), ("capture_like", 2))
"""(set of scenes, seed): none that is kept for reporting, as the constants of the merging were chosen on them."""
BUDGETS = (0.5, 0.25, 0.1, 0.05)
SETTINGS = (*FLOOR, "depth.method=sweep")
PSNR = MetricsParams(measures=["psnr"])


def scene_rows(scenes: str, seed: int, budgets: list[float]) -> list[dict[str, Any]]:
    """One row for all Gaussians of a scene, and two for every budget."""
    cell = Cell(seed, 8 if scenes == "plain" else None, size=384, frames=1, scenes=scenes)
    with tempfile.TemporaryDirectory() as folder:
        _, held_out = film_cell(cell, Path(folder))
        results, _ = run_capture(Path(folder), (held_out, *SETTINGS))
        whole = frame_gaussians(results, 0, results.context.views.sources, torch.float32)
        own = {"scenes": scenes, "seed": seed}
        base = drawn(results, whole, scenes)
        rows = [{**own, "kind": "all", "budget": 1.0, "gaussians": len(whole), **base, "gain dB": 0.0, "seconds": 0.0}]
        for budget in budgets:
            begun = time.process_time()
            merged = within_budget(whole, budget)
            seconds = time.process_time() - begun
            for kind, left in (("merged", merged), ("chosen", enlarged_choice(whole, budget))):
                found = drawn(results, left, scenes)
                gain = {"gain dB": found["box psnr"] - base["box psnr"], "seconds": seconds * (kind == "merged")}
                rows.append({**own, "kind": kind, "budget": budget, "gaussians": len(left), **found, **gain})
    show(rows)
    return rows


def enlarged_choice(gaussians: Gaussians, budget: float) -> Gaussians:
    """A share of them, taken at random, 1 / sqrt(budget) times as large along the surface."""
    kept = np.sort(np.random.default_rng(0).permutation(len(gaussians))[: int(budget * len(gaussians))])
    some = Gaussians(*(getattr(gaussians, name)[torch.from_numpy(kept)] for name in Gaussians.__dataclass_fields__))
    larger = torch.tensor([budget**-0.5, budget**-0.5, 1], dtype=some.scale.dtype)
    return replace(some, scale=some.scale * larger)


def drawn(results: Results, gaussians: Gaussians, scenes: str) -> dict[str, float]:
    """Means over the held-out pictures of the first frame."""
    context, psnr, through = results.context, [], []
    for view in context.views.held_out:
        width, height = (int(n) for n in context.rig.size[view])
        camera = Camera(context.rig.intrinsics[view], context.rig.world_to_camera[view], width, height)
        truth, mask = (results.read(a, range(1), view)[0][:height, :width] for a in ("frames/color", "frames/mask"))
        rendering = rasterize(gaussians, [camera])
        picture = quantise(rendering.color[0])
        if scenes == "capture_like":  # these expose differently, which no other camera's picture can know
            picture = np.rint(fitted(picture, truth, mask)[0])
        value = measure(picture, truth, mask, PSNR)["box", "psnr"]
        assert isinstance(value, float), value
        psnr.append(value)
        through.append(1 - float(rendering.alpha[0].numpy()[foreground(mask)].mean()))
    return {"box psnr": float(np.mean(psnr)), "through %": 100 * float(np.mean(through))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", choices=tuple(SCENES), help="with --seeds; default: two plain, one like a capture")
    parser.add_argument("--seeds", type=seeds)
    parser.add_argument("--budgets", type=float, nargs="+", default=list(BUDGETS))
    a = parser.parse_args()
    if (a.scenes is None) != (a.seeds is None):
        parser.error("--scenes and --seeds belong together; give both, or none for the published figures")
    one_thread()
    cells = CELLS if a.scenes is None else tuple((a.scenes, seed) for seed in a.seeds)
    rows = [row for scenes, seed in cells for row in scene_rows(scenes, seed, a.budgets)]
    table = [
        {k: r[k] for k in ("kind", "budget", "box psnr", "gain dB", "through %", "seconds")}
        for r in means(rows, "kind", "budget")
    ]
    published = a.scenes is None and tuple(a.budgets) == BUDGETS
    publish("budget" if published else None, table, {"cells": cells, "settings": SETTINGS, "scenes": rows})


if __name__ == "__main__":
    main()
