"""What the trained network gains over the analytic floor on simulated people at 512 px, beside true depth, and its
gates.

    python -m benchmarks.network.gain                                             the published figures: seeds
    9000-9007, the shipped `fast` python -m benchmarks.network.gain --seeds 1-3 --weights FILE.safetensors      tuning;
    seeds from 9000 on are for publishing only

Eight cameras, two held out in the middle between two sources, everything clean; regions, EPE and places of the error as
in
`benchmarks.quality.views`. A scene is filmed once; floor, network and truth differ in nothing but `network.weights` and
`depth.method`. Confidence is the mean share of the learned value over the source views' surface; network s are CPU
seconds a frame of the stage `network`, all pairs of eight views.

EPE is told for every number of iterations that the weights were trained with, too, and for one more.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.network.picture import draw
from benchmarks.quality.cells import FLOOR, Cell, film_cell, pictures
from benchmarks.quality.views import means, seeds
from benchmarks.report import publish, show
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import depths, run_capture
from posegaussian.stages.network.asset import card_of, weights_digest
from posegaussian.stages.network.card import shipped
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.simulator.quality_scenes import REPORTING_SEEDS

SHOWN = (
    "depth",
    "box psnr",
    "box ssim",
    "full psnr",
    "full ssim",
    "EPE",
    "EPE median",
    "1 px",
    "mm",
    "outside",
    "rim",
    "holes",
    "inside",
    "confidence",
    "network s",
    "depth s",
    "gaussians s",
    "rendering s",
)
CAMERAS = 8
GROWS = 0.03
"""Share by which EPE may grow with the iterations, at most."""
WORST = -0.1
"""dB of box PSNR that the network may cost a scene."""


@dataclass(frozen=True)
class Gate:
    """What weights of a preset must gain."""

    decibels: float
    """Of box PSNR, mean over the scenes."""
    share: float
    """Of the way from the floor to true depth, box PSNR; the larger of both counts."""
    epe: float
    """Share of the floor's EPE that must be gone."""


GATES = {"fast": Gate(0.6, 0.12, 0.15), "base": Gate(1.0, 0.20, 0.25)}


def measured(
    cell: Cell, floor: str, weights: str, others: tuple[int, ...], folder: Path, settings: tuple[str, ...]
) -> tuple[list[dict[str, Any]], dict[int, float]]:
    """Rows of floor, network and truth, and EPE by number of iterations: the stage's own setting and `others`."""
    motion, held_out = film_cell(cell, folder)
    base, learned = (
        (held_out, *FLOOR, *settings),
        (f"depth.method={floor}", f"network.weights={weights}"),
    )
    epe: dict[int, float] = {}
    for n in others:
        # Gaussians and pictures of other numbers of iterations are not looked at.
        results, _ = run_capture(folder, (*base, *learned, f"network.iterations={n}"), UP_TO_NETWORK)
        epe[n] = depths(results)["EPE"]
    rows = []
    for name, own in (("floor", (f"depth.method={floor}",)), ("network", learned), ("truth", ("depth.method=truth",))):
        results, seconds = run_capture(folder, (*base, *own))
        row = {"seed": cell.seed, "motion": motion, "depth": name, **pictures(results, cell), **depths(results)}
        row["confidence"] = confidence(results, cell) if name == "network" else 0.0
        rows.append(
            {**row, **{f"{s} s": seconds[s] / cell.frames for s in ("depth", "network", "gaussians", "rendering")}}
        )
        if name == "network":
            epe[results.context.settings.network.iterations] = row["EPE"]
    return rows, dict(sorted(epe.items()))


UP_TO_NETWORK = Selection(only=frozenset({"survey", "frames", "pose", "smoothing", "depth", "network"}))


def confidence(results: Results, cell: Cell) -> float:
    """Mean share of the learned value over the surface of all source views."""
    found = []
    for view in results.context.views.sources:
        depth, share = (results.read(a, range(cell.frames), view) for a in ("network/depth", "network/confidence"))
        found.append(share[depth > 0].astype(np.float64))
    return float(np.concatenate(found).mean())


def gates(
    rows: Sequence[dict[str, Any]], epe: Mapping[int, float], gate: Gate, trained: int
) -> Iterator[tuple[str, bool]]:
    """(sentence, whether it holds) for everything that must hold of the weights."""
    scenes = {kind: [r for r in rows if r["depth"] == kind] for kind in ("floor", "network", "truth")}
    psnr, off = ({kind: np.array([r[k] for r in found]) for kind, found in scenes.items()} for k in ("box psnr", "EPE"))
    gains = psnr["network"] - psnr["floor"]
    way = float((psnr["truth"] - psnr["floor"]).mean())
    gain, asked = float(gains.mean()), max(gate.decibels, gate.share * way)
    yield (
        (
            f"box PSNR {gain:+.2f} dB of at least {asked:+.2f} ({gate.decibels:g} dB or {gate.share:.0%} of the"
            f" {way:.2f} dB to true depth, whichever is more)"
        ),
        gain >= asked,
    )
    less = 1 - float(off["network"].mean() / off["floor"].mean())
    yield (
        (
            f"EPE {off['network'].mean():.2f} px, {less:.0%} less than the floor's {off['floor'].mean():.2f}, of at"
            f" least {gate.epe:.0%}"
        ),
        less >= gate.epe,
    )
    worst = int(gains.argmin())
    yield (
        (
            f"box PSNR at worst {gains[worst]:+.2f} dB (seed {scenes['floor'][worst]['seed']}),"
            f" on no scene below {WORST:+.1f}"
        ),
        bool(gains.min() >= WORST),
    )
    if len(gains) > 1:
        error = float(gains.std(ddof=1)) / math.sqrt(len(gains))
        yield (
            f"the mean gain {gain:.2f} dB is more than twice its standard error over {len(gains)} scenes, {error:.2f}",
            gain > 2 * error,
        )
    for n in sorted(epe)[1:]:
        best = min(v for k, v in epe.items() if k < n)
        if n <= trained:
            yield (
                f"EPE after {n} iterations {epe[n]:.3f} px, at most {GROWS:.0%} above the best of fewer, {best:.3f}",
                epe[n] <= (1 + GROWS) * best,
            )


def gains_by_scene(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a scene: what the network changes."""
    found = []
    for seed in dict.fromkeys(r["seed"] for r in rows):
        floor, network, true = (
            next(r for r in rows if (r["seed"], r["depth"]) == (seed, kind)) for kind in ("floor", "network", "truth")
        )
        gains = {f"{k} gain": network[k] - floor[k] for k in ("box psnr", "box ssim", "full psnr")}
        found.append(
            {
                "seed": seed,
                "motion": floor["motion"],
                **gains,
                "to true depth": true["box psnr"] - floor["box psnr"],
                "EPE floor": floor["EPE"],
                "EPE network": network["EPE"],
                "confidence": network["confidence"],
            }
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=tuple(REPORTING_SEEDS))
    parser.add_argument("--weights", default="fast", help="a name that ships, or a file")
    parser.add_argument("--floor", choices=("sweep", "sgbm"), default="sweep", help="the analytic depth beneath")
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--iterations", choices=("all", "set"), default="all", help="all: also EPE by number of iterations"
    )
    parser.add_argument("--picture", type=Path, help="PNG; docs/measurements/network.png where figures are published")
    parser.add_argument(
        "--set", action="append", default=[], help="a setting of the pipeline, as for `posegaussian run`"
    )
    a = parser.parse_args()
    weights = a.weights if a.weights in shipped() else str(Path(a.weights).resolve())
    params = NetworkParams(weights=weights)
    card = card_of(params)
    others = tuple(n for n in range(1, card.iterations + 2) if n != params.iterations) if a.iterations == "all" else ()
    cells = [Cell(s, CAMERAS, size=a.size, frames=a.frames) for s in a.seeds]
    rows: list[dict[str, Any]] = []
    by_scene: list[dict[int, float]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(a.processes, initializer=limit, initargs=(1,)) as pool,
    ):
        jobs = [
            pool.submit(measured, c, a.floor, weights, others, Path(folder) / str(c.seed), tuple(a.set)) for c in cells
        ]
        for job in jobs:
            found, epe = job.result()
            rows += found
            by_scene.append(epe)
            floor, network, true = (r["box psnr"] for r in found)
            print(
                f"seed {found[0]['seed']} ({found[0]['motion']}): floor {floor:.2f} dB, network {network:.2f}"
                f" ({network - floor:+.2f}), true depth {true:.2f}; EPE {found[0]['EPE']:.2f} ->"
                f" {found[1]['EPE']:.2f} px",
                flush=True,
            )
    epe = {n: float(np.mean([e[n] for e in by_scene])) for n in by_scene[0]}
    # Only the reporting seeds are published: benchmarks/results and docs/measurements/network.png.
    writes = a.seeds == tuple(REPORTING_SEEDS)
    by_seed, counted = (
        gains_by_scene(rows),
        [{"iterations": n, "EPE": e, "trained with": "yes" if n <= card.iterations else "no"} for n, e in epe.items()],
    )
    said = {
        "weights": card.name,
        "sha256": weights_digest(params),
        "preset": card.preset,
        "floor": a.floor,
        "seeds": list(a.seeds),
        "size": a.size,
        "frames": a.frames,
        "set": a.set,
    }
    publish(
        "network" if writes else None,
        [{k: r[k] for k in SHOWN} for r in means(rows, "depth")],
        {**said, "scenes": by_seed, "iterations": counted},
    )
    show(by_seed)
    show(counted)
    picture = a.picture or (Path("docs/measurements/network.png") if writes else None)
    if picture is not None:
        draw(rows, picture)
    gate = GATES.get(card.preset)
    if gate is None:
        print(f"no gates for weights of preset {card.preset}; there are some for {', '.join(GATES)}")
        return
    for sentence, holds in gates(rows, epe, gate, card.iterations):
        print("holds  " if holds else "FAILS  ", sentence)


if __name__ == "__main__":
    main()
