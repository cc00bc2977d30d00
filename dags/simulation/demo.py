"""The whole way on a capture the project makes itself: film, import, run, export, measure."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from rich.console import Console

from posegaussian.dags.export.pictures import write_exports
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session

SETTINGS = Path(__file__).with_name("demo.yaml")
"""Configuration of the demo, laid over the packaged default."""

NAME = "demo"
"""Name of the demo's sequence."""


def film(folder: Path, size: int, frames: int, console: Console) -> None:
    """Write the capture of the scene `demo` as an `images` folder: pictures, masks, joints, true depth, cameras."""
    from posegaussian.dags.simulation.shipped import scene_file
    from posegaussian.dags.simulation.simulate import effects_plan, read_scene, stage_scene
    from posegaussian.dags.simulation.simulate import film as film_scene
    from posegaussian.stages.simulator.scene import Listed

    path = scene_file("demo")
    scene = read_scene(path)
    assert not isinstance(scene.rig, Listed)
    scene = scene.model_copy(update={"frames": frames, "rig": scene.rig.model_copy(update={"size": (size, size)})})
    staged = stage_scene(scene, path.parent)
    console.print(effects_plan(NAME, scene, staged.rulings))
    film_scene(scene, staged, folder, os.cpu_count() or 1)


def run_demo(output: Path, size: int, frames: int, scheduler: str | None, console: Console) -> int:
    """Film, import, run, export; prints where everything lies. Returns the exit status."""
    start = time.perf_counter()
    session = Session.open(
        SETTINGS, [f"run.scheduler={scheduler}"] if scheduler else [], str(output / "archive"), console
    )
    settings = session.configuration.for_sequence(NAME)
    capture_folder = output / f"capture_{size}px_{frames}f"
    if not (capture_folder / "cameras.json").is_file():
        console.print(
            f"filming {frames} frames of a walking person"
            f" with {8 + len(settings.views.held_out)} cameras at {size} x {size} px",
            markup=False,
        )
        film(capture_folder, size, frames, console)
    from posegaussian.storage.archive.store import Archive

    capture = find_capture("images", capture_folder, [], settings)
    register(Archive.open(session.archive_url, create=True), NAME, capture, settings)
    plan = session.plan(NAME, Selection())
    status = session.run_and_report([plan], Selection())
    if status:
        return status
    for name, path in plan.context.paths.items():
        chosen = session.plan(NAME, Selection(), (path.kind,))
        sheet = output / f"contact_sheet_{path.kind}.png"
        video = output / f"{path.kind}.mp4" if path.kind == "orbit" else None
        for line in write_exports(chosen, video, None, sheet if path.kind == "held_out" else None):
            session.say([line])
        if path.kind == "held_out":
            console.print(f"metrics: {plan.context.sequence.root / 'metrics' / name}", markup=False, soft_wrap=True)
            console.print(summary(Results(plan.context).table("metrics/{path}", name)), markup=False)
    console.print(f"the whole demo took {time.perf_counter() - start:.0f} s", markup=False)
    console.print(f"{next_command('import', 'auto', 'FOLDER')}, the folder of a capture of your own", markup=False)
    return 0


def summary(rows: list[dict[str, Any]]) -> str:
    """Mean of every measure and region over frames and cameras, one line."""
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for row in rows:
        if row["value"] is not None:  # a measure that something is missing for
            values[row["region"], row["measure"]].append(row["value"])
    return "held-out views: " + ", ".join(
        f"{region} {measure} {sum(v) / len(v):.3f}" for (region, measure), v in sorted(values.items())
    )
