"""What a calibration that is a little off costs, and what `calibration_correction` gives back of it.

    python -m benchmarks.quality.calibration                               the published figures: both reporting sets
    python -m benchmarks.quality.calibration --scenes plain --seeds 1-2 --size 384                  tuning

One frame a scene, everything as it is set by default, refined. The source cameras are written down turned by random
angles that move their pictures by so many px, one standard deviation an axis, and set down so many mm from their
places; held-out ones are right. Box PSNR and SSIM of two held-out cameras midway, as written down and with the effect
as it decides, and by how much pairs of source views miss what both see, root mean square over points about the person
that the cameras which filmed see. `right` is the same scene with the cameras that filmed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations, repeat
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import SCENES, Cell, pictures
from benchmarks.quality.picture import around, save, tile
from benchmarks.quality.views import means, seeds
from benchmarks.report import show
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import CAPTURE, film_capture, held_out_setting, run_capture
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.model.cameras import Rig

EFFECT = "calibration_correction"
REACH = (0.3, 0.3, 0.9)
"""Metres from the middle of the person in which points lie, along the world's axes."""
POINTS = 400


@dataclass(frozen=True)
class Off:
    """By how much cameras are written down wrongly."""

    pixels: float
    millimetres: float

    def __str__(self) -> str:
        return f"{self.pixels:g} px, {self.millimetres:g} mm" if self.pixels or self.millimetres else "right"


def rows_of(cell: Cell, offs: tuple[Off, ...], settings: tuple[str, ...]) -> list[dict[str, Any]]:
    """One row for every error: as written down, and as decided."""
    rows = []
    for off in offs:
        folder = Path(tempfile.mkdtemp())
        held_out, true = filmed(cell.scene, off, folder)
        row: dict[str, Any] = {"scenes": cell.scenes, "seed": cell.seed, "cameras": cell.scene.rig.cameras}
        row["off"], shown = str(off), dict[str, np.ndarray]()
        for state in ("off", "auto"):
            results, _ = run_capture(folder, (held_out, f"effects.{EFFECT}={state}", *settings))
            context, found = results.context, pictures(results, cell)
            sources = list(context.views.sources)
            filming = replace(context.rig, world_to_camera=true.world_to_camera)
            row |= {
                f"{state} dB": found["box psnr"],
                f"{state} SSIM": found["box ssim"],
                f"{state} px": missed(filming.subset(sources), context.rig.subset(sources)),
            }
            shown.setdefault("filmed", found["shown"][1])
            shown[f"{state} {found['box psnr']:.1f} dB"] = found["shown"][0]
        span = around(shown["filmed"])
        row["shown"] = np.hstack([tile(p[:, span], text) for text, p in shown.items()])
        row["decided"] = results.context.effects[EFFECT].state
        rows.append(row)
        shutil.rmtree(folder)
    return rows


def filmed(scene: Scene, off: Off, folder: Path) -> tuple[str, Rig]:
    """Film a scene into a folder, its source cameras written down wrongly and its held-out ones rightly; the setting
    that keeps these aside, and the cameras that filmed."""
    error = {"pixels": off.pixels, "metres": off.millimetres / 1000}
    given = scene.model_dump()
    wrong = Scene.model_validate({**given, "effects": {**given["effects"], "calibration_error": error}})
    staged, _ = film_capture(wrong, folder)
    true = staged.take.rig
    file = folder / CAPTURE / "cameras.json"
    written = json.loads(file.read_text())
    for camera in written["cameras"]:
        v = staged.written.index(camera["name"])
        if v >= staged.sources:
            camera["R"], camera["t"] = true.rotations[v].tolist(), true.world_to_camera[v, :3, 3].tolist()
    file.write_text(json.dumps(written))
    return held_out_setting(staged), true


def without_picture(row: dict[str, Any]) -> dict[str, Any]:
    """Numbers and words alone."""
    return {k: v for k, v in row.items() if k != "shown"}


def missed(true: Rig, rig: Rig) -> float:
    """Px by which pairs of a rig miss each other's lines with points that the true cameras see."""
    middle, off = look_at_point(true), []
    points = middle + np.random.default_rng(0).uniform(-1, 1, (POINTS, 3)) * REACH
    for a, b in combinations(range(len(true)), 2):
        x, y = (project(points, true.intrinsics[v], true.world_to_camera[v])[0] for v in (a, b))
        off.append(signed_epipolar_distance(fundamental(rig, a, b), x, y))
    return float(np.sqrt(np.mean(np.square(off))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--seeds", type=seeds, help="of each set; the reporting ones")
    parser.add_argument("--cameras", type=int, default=8, help="of plain scenes; those like captures have their own")
    parser.add_argument("--pixels", nargs="*", type=float, default=[0.0, 0.3, 1.0])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--picture", type=Path, help="a PNG: filmed, as written down and as decided, a line a row")
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    a = parser.parse_args()
    offs = tuple(Off(p, p) for p in a.pixels)
    cells = [
        Cell(seed, a.cameras if scenes == "plain" else None, size=a.size, frames=1, scenes=scenes)
        for scenes in a.scenes
        for seed in a.seeds or SCENES[scenes]
    ]
    with ProcessPoolExecutor(a.processes, initializer=limit, initargs=(1,)) as pool:
        rows = []
        for found in pool.map(rows_of, cells, repeat(offs), repeat(tuple(a.set))):
            rows += found
            show([without_picture(r) for r in found])
    if a.picture:
        save([r["shown"] for r in rows], a.picture)
    show(means(rows, "scenes", "off"))


if __name__ == "__main__":
    main()
