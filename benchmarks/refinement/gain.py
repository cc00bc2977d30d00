"""What refinement is worth and what it costs, beside per-scene 3D Gaussian splatting, on simulated people at 512 px.

    python -m benchmarks.refinement.gain                                     the published figures: seeds 9000-9007
    python -m benchmarks.refinement.gain --scenes capture_like --minutes     seeds 9100-9107, without 3dgs
    python -m benchmarks.refinement.gain --seeds 1-4 --minutes 0.25 --steps 0 50    tuning; seeds from 9000 on are for
    publishing only

Eight cameras on a ring, or those of a scene like a capture; two held out in the middle of gaps, one frame a scene.
`floor` is the pipeline without network and refinement, `refinement default` as it is set by default, `refinement STEPS`
the same but for that many steps as far as they gain anything, from the network's Gaussians where the judge lets it,
`refinement 1/10` the default with a Gaussian at a tenth of the source pictures' pixels (`--steps default 1/10`);
seconds are the CPU seconds a frame of all stages from frames to the rendering of both held-out pictures. `3dgs` is
per-scene splatting from points on the visual hull, with densification (benchmarks/baselines/splatting.py); its seconds
are CPU seconds of the optimisation alone. Box PSNR is that of the held-out pictures, clipped to the source masks' hull
and filled by the same code; `3dgs, unclipped` is what a user of 3DGS sees.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.baselines.splatting import FreeGaussians, Scene, optimised
from benchmarks.quality.cells import FLOOR, SCENES, Cell, film_cell
from benchmarks.quality.light import fitted
from benchmarks.quality.views import means, seeds
from benchmarks.refinement.picture import draw
from benchmarks.report import publish, show
from posegaussian.dags.planning.results import Results
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.refinement.params import RefinementParams, pixels_a_gaussian
from posegaussian.stages.rendering.run import quantise

GAIN = 1.5
"""dB that 50 steps gain over the floor on the mean."""
LOSS, LOSS_OF_VIEW = 0.1, 0.2
"""dB that no scene, and no held-out view of one, may lose by them."""
MADE = ("frames", "pose", "smoothing", "depth", "network", "gaussians", "refinement", "rendering")
"""Stages whose seconds count."""
PSNR = MetricsParams(measures=["psnr"])


def refined(cell: Cell, folder: Path, settings: tuple[str, ...], levels: list[str]) -> list[dict[str, Any]]:
    """The floor's row, then one a level; what does not depend on it is made once and counts for each."""
    rows: list[dict[str, Any]] = []
    seconds: dict[str, float] = {}
    sources = 0
    for level in ("floor", *levels):
        results, now = run_capture(folder, (*settings, *_settings(level, sources)))
        sources = len(results.context.views.sources)
        seconds |= now
        views = _by_view(results, cell)
        spent = {s: seconds.get(s, 0.0) / cell.frames for s in MADE if s != "refinement" or level not in ("floor", "0")}
        rows.append(
            {
                "method": "floor" if level == "floor" else "refinement",
                "level": "0" if level == "floor" else level,
                "box psnr": float(np.mean(views)),
                "optimisation s": spent.get("refinement", 0.0),
                "seconds": sum(spent.values()),
                "views": views,
            }
        )
    return rows


def _level(text: str) -> str:
    """A level of `--steps`. Raises ValueError for what is neither `default` nor a number nor a share."""
    return text if text == "default" or (text.startswith("1/") and int(text[2:])) else str(int(text))


def _settings(level: str, sources: int) -> tuple[str, ...]:
    """Of the floor, of the default, of a Gaussian at such a share of the pixels of so many source views, or of so many
    steps."""
    if level.startswith("1/"):
        usual = RefinementParams()  # fewer than eight views keep more of each
        return (f"refinement.every={int(level[2:]) * usual.every / pixels_a_gaussian(sources, usual)}",)
    return {"floor": tuple(FLOOR), "default": ()}.get(level, (f"refinement.steps={level}", "refinement.worth=0"))


def _by_view(results: Results, cell: Cell) -> list[float]:
    """Box PSNR of each held-out view of the first frame; of scenes like captures in the held-out camera's light."""
    context, found = results.context, []
    (path,) = context.paths.values()
    color = results.read(f"rendering/{path.name}/color", range(1))[0]
    for picture, name in zip(color, path.names, strict=True):
        view = context.rig.index(name)
        truth, mask = (results.read(f"frames/{a}", range(1), view)[0] for a in ("color", "mask"))
        if cell.scenes == "capture_like":
            picture = np.clip(np.rint(fitted(picture, truth, mask)[0]), 0, 255).astype(np.uint8)
        found.append(_psnr(picture, truth, mask))
    return found


def plain(cell: Cell, folder: Path, settings: tuple[str, ...], minutes: list[float]) -> list[dict[str, Any]]:
    """One row a time, of the first frame."""
    results, _ = run_capture(folder, (*FLOOR, *settings, "depth.method=hull"))
    scene = Scene.of(results)
    rows: list[dict[str, Any]] = []

    def watch(spent: float, gaussians: FreeGaussians) -> None:
        found = [[_box_psnr(results, p, v, scene.masks[v]) for p in shown] for v, *shown in scene.pictures(gaussians)]
        for name, value in zip(("3dgs", "3dgs, unclipped"), np.mean(found, axis=0), strict=True):
            rows.append(
                {
                    "method": name,
                    "level": f"{spent:g} s",
                    "box psnr": float(value),
                    "optimisation s": spent,
                    "seconds": spent,
                    "gaussians": len(gaussians),
                }
            )

    for steps in optimised(scene.start(), scene.filmed(), [60 * m for m in minutes], watch):
        print(
            f"seed {cell.seed}, 3dgs {rows[-1]['level']}, {steps} steps, {rows[-1]['gaussians']} Gaussians: box"
            f" {rows[-2]['box psnr']:.2f} dB, {rows[-1]['box psnr']:.2f} unclipped",
            flush=True,
        )
    return rows


def _box_psnr(results: Results, picture: np.ndarray, view: int, mask: np.ndarray) -> float:
    return _psnr(quantise(torch.from_numpy(picture)), results.read("frames/color", range(1), view)[0], mask)


def _psnr(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    value = measure(picture, truth, mask, PSNR)["box", "psnr"]
    assert isinstance(value, float)
    return value


def scene_rows(
    scenes: str, seed: int, levels: list[str], minutes: list[float], settings: tuple[str, ...]
) -> list[dict[str, Any]]:
    """Every row of one seed."""
    cell = Cell(seed, 8 if scenes == "plain" else None, frames=1, scenes=scenes)
    with tempfile.TemporaryDirectory() as folder:
        _, held_out = film_cell(cell, Path(folder))
        found = refined(cell, Path(folder), (held_out, *settings), levels)
        for row in found:
            print(
                f"seed {seed}, {row['method']} {row['level']}: box {row['box psnr']:.2f} dB"
                f" ({', '.join(f'{v:.2f}' for v in row['views'])}), refinement"
                f" {row['optimisation s']:.1f} s of {row['seconds']:.1f} s",
                flush=True,
            )
        found += plain(cell, Path(folder), (held_out, *settings), minutes) if minutes else []
    return [{"seed": seed, **r} for r in found]


def one_thread() -> None:
    """One thread for every library of this process."""
    limit(1)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", choices=tuple(SCENES), default="plain")
    parser.add_argument("--seeds", type=seeds, help="default: those for reporting")
    parser.add_argument(
        "--steps", type=_level, nargs="+", default=["0", "20", "50", "200"], help="numbers, `default`, and shares"
    )
    parser.add_argument(
        "--minutes", type=float, nargs="*", default=[0.25, 1, 3, 10], help="of 3DGS; none: leave it out"
    )
    parser.add_argument(
        "--set", action="append", default=[], help="a setting of the pipeline, as for `posegaussian run`"
    )
    parser.add_argument("--processes", type=int, default=2)
    a = parser.parse_args()
    chosen = a.seeds or SCENES[a.scenes]
    with ProcessPoolExecutor(a.processes, initializer=one_thread) as pool:
        jobs = [pool.submit(scene_rows, a.scenes, seed, a.steps, a.minutes, tuple(a.set)) for seed in chosen]
        rows = [row for job in jobs for row in job.result()]
    table = [
        {k: r[k] for k in ("method", "level", "optimisation s", "seconds", "box psnr")}
        for r in means(rows, "method", "level")
    ]
    if chosen == SCENES["plain"] and a.minutes and {"0", "20", "50", "200"} <= set(a.steps):
        publish(
            "refinement",
            table,
            {"seeds": list(chosen), "steps": a.steps, "minutes": a.minutes, "set": a.set, "scenes": rows},
        )
        draw(table, Path("docs/measurements/refinement.png"))
    else:
        show(table)
    for sentence, holds in gates(rows):
        print("holds  " if holds else "FAILS  ", sentence)


def gates(rows: list[dict[str, Any]]) -> list[tuple[str, bool]]:
    """(sentence, whether it holds): what 50 steps gain over the floor on the mean, and over none on the worst scene and
    in the worst view."""
    made = {(r["seed"], r["method"], r["level"]): r for r in rows}
    scenes = [s for s in dict.fromkeys(r["seed"] for r in rows) if (s, "refinement", "50") in made]
    if not scenes or (scenes[0], "refinement", "0") not in made:
        return []
    after = {s: made[s, "refinement", "50"] for s in scenes}
    before = {s: made[s, "refinement", "0"] for s in scenes}
    over_floor = float(np.mean([after[s]["box psnr"] - made[s, "floor", "0"]["box psnr"] for s in scenes]))
    gains = {s: after[s]["box psnr"] - before[s]["box psnr"] for s in scenes}
    views = {s: float(np.min(np.subtract(after[s]["views"], before[s]["views"]))) for s in scenes}
    mean = float(np.mean(list(gains.values())))
    worst, seen = (min(found, key=found.__getitem__) for found in (gains, views))
    return [
        (
            (
                f"50 steps gain {over_floor:+.2f} dB of at least {GAIN:+.2f} over the floor on the mean, {mean:+.2f}"
                " over none"
            ),
            over_floor >= GAIN,
        ),
        (f"50 steps gain {gains[worst]:+.2f} dB at worst (seed {worst}), at least {-LOSS:+.1f}", gains[worst] >= -LOSS),
        (
            f"50 steps gain {views[seen]:+.2f} dB in the worst view (seed {seen}), at least {-LOSS_OF_VIEW:+.1f}",
            views[seen] >= -LOSS_OF_VIEW,
        ),
    ]


if __name__ == "__main__":
    main()
