"""Which gains are given to cameras that are alike, and to cameras that differ by half a stop.

    python -m benchmarks.frames.exposure_gains [--scenes capture_like] [--seeds 9100-9107] [--size 512]

Simulated people of both sets (`benchmarks.quality.views`), one frame, with masks and without joints, which no gain is
made of. Every scene is filmed by cameras that expose alike, then some of its cameras, drawn by the scene's seed, are
made half a stop darker, as a sensor would: on light, before it is rounded. Alike, `exposure_matching` must stay off.
Half a stop apart it must be on, and what the gains leave between any two cameras is told, in stops, the worst channel;
cameras that share too few surface points keep their light, and are counted.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import SCENES, Cell
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting, run_capture
from posegaussian.stages.frames.exposures import SURFACE, compared, points_in
from posegaussian.stages.imaging import exposure
from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.readers import images

APART = 0.5
"""Stops."""
DECIDING = Selection(only=frozenset({"survey", "judge"}))
"""Stages that decide on gains."""


class AlikeCell(Cell):
    """A cell whose cameras expose alike, whatever its scene says."""

    @cached_property
    def scene(self) -> Scene:
        """What is filmed."""
        scene = super().scene
        return scene.model_copy(update={"effects": scene.effects.model_copy(update={"camera_gain": None})})


def darker(seed: int, cameras: int) -> np.ndarray:
    """[cameras] bool: which source cameras are darker, some and not all."""
    drawn = np.random.default_rng(seed).random(cameras)
    return np.asarray(drawn < np.median(drawn))


def darken(capture: Path, chosen: np.ndarray) -> None:
    """The chosen source cameras (cam00, cam01, ...) by `APART` stops."""
    for folder in sorted(p for p in (capture / "images").iterdir() if p.name.startswith("cam")):
        if chosen[int(folder.name[3:])]:
            for file in sorted(folder.iterdir()):
                light = to_linear(images.read_picture(file).astype(np.float64)) * np.exp2(-APART)
                images.write_png(file, np.rint(to_srgb(light)).astype(np.uint8))


def apart(results: Results, stops: np.ndarray, applied: bool) -> tuple[float, int]:
    """(Stops between two source cameras after matching, the worst channel of those cameras that are compared with
    another; how many are compared with none), where each is brighter by `stops` [S]."""
    sources = list(results.context.views.sources)
    evidence = results.context.evidence("frames")
    known = compared(evidence.facts) in evidence.noted  # else features settled it
    surface = points_in(evidence) if known else evidence.noted[SURFACE][:, sources]
    enough = (surface < exposure.NONE).all(axis=-1).sum(axis=-1) >= exposure.FEWEST_POINTS  # [S, S]
    linked = (enough | enough.T).any(axis=1)
    found = exposure.match(surface)
    gains = np.log2(found.gains) if applied and found is not None else np.zeros((len(sources), 3))
    light = (gains + stops[:, None])[linked]
    return float(np.ptp(light, axis=0).max()) if linked.any() else float(np.ptp(stops)), int((~linked).sum())


def rows_of(cell: Cell) -> list[dict[str, Any]]:
    """Cameras alike, and half a stop apart."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        staged, _ = film_capture(cell.scene, folder)
        for joints in (folder / "capture").rglob("*joints*"):
            shutil.rmtree(joints) if joints.is_dir() else joints.unlink()
        chosen = darker(cell.seed, staged.sources)
        for stops in (0.0, APART):
            if stops:
                darken(folder / "capture", chosen)
                shutil.rmtree(folder / "archive")  # the survey keeps what it saw of a sequence
            results, _ = run_capture(folder, (held_out_setting(staged),), DECIDING)
            decision = results.context.effects["exposure_matching"].decision
            on = decision is not None and decision.on
            remains, alone = apart(results, -stops * chosen, on)
            print(f"seed {cell.seed}, {stops} stops apart: {decision.reason if decision else ''}", flush=True)
            rows.append(
                {
                    "scenes": cell.scenes,
                    "seed": cell.seed,
                    "cameras": len(results.context.views.sources),
                    "stops apart": stops,
                    "exposure_matching": "on" if on else "off",
                    "left, stops": remains,
                    "not compared": alone,
                }
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", choices=(*SCENES, "both"), default="both")
    parser.add_argument("--seeds", type=seeds, help="default: those for reporting")
    parser.add_argument("--size", type=int, default=512)
    a = parser.parse_args()
    sets = tuple(SCENES) if a.scenes == "both" else (a.scenes,)
    cells = [AlikeCell(s, None, size=a.size, frames=1, scenes=name) for name in sets for s in a.seeds or SCENES[name]]
    rows = [row for cell in cells for row in rows_of(cell)]
    published = a.seeds is None and a.scenes == "both"
    publish("exposure_gains" if published else None, rows, {"size": a.size})


if __name__ == "__main__":
    main()
