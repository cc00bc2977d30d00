"""Scenes filmed into a folder and run by the pipeline there, as benchmarks and ablations do."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.executors.inline_run import run_here
from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.simulate import film, stage_scene
from posegaussian.stages.network.params import depth_array
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.masks import foreground

if TYPE_CHECKING:
    from posegaussian.stages.simulator.setup import Staged

NAME = "person"
"""Of the sequence in the folder's archive."""
CAPTURE, ARCHIVE = "capture", "archive"
ALL = Selection()


def film_capture(scene: Scene, folder: Path, threads: int = 1) -> tuple[Staged, dict[str, np.ndarray]]:
    """Film a scene into `folder/capture`;
    the staged scene, and the truth that `posegaussian.dags.simulation.simulate.film` gives."""
    staged = stage_scene(scene, folder)
    return staged, film(scene, staged, folder / CAPTURE, threads)


def held_out_setting(staged: Staged) -> str:
    """The setting that keeps a scene's held-out cameras aside."""
    return f"views.held_out={json.dumps(list(staged.written.names[staged.sources :]))}"


def registered(folder: Path, settings: tuple[str, ...], archive: str = ARCHIVE) -> Session:
    """A silent session under `settings`, with the capture of `folder` registered in an archive there."""
    url = str(folder / archive)
    session = Session(load_configuration(None, list(settings), folder=folder), url, Console(quiet=True))
    own = session.configuration.for_sequence(NAME)
    register(Archive.open(url, create=True), NAME, find_capture("images", folder / CAPTURE, [], own), own)
    return session


def run_capture(
    folder: Path,
    settings: tuple[str, ...],
    selection: Selection = ALL,
    archive: str = ARCHIVE,
    threads: int = 1,
    after_each: Callable[[], None] | None = None,
) -> tuple[Results, Counter[str]]:
    """Run the capture of `folder` under `settings` into an archive there; what does not depend on them stays fresh.

    Returns the results, and CPU seconds by stage of what ran. Raises as
    `posegaussian.dags.runtime.executors.inline_run.run_here` does.
    """
    plan = registered(folder, settings, archive).plan(NAME, selection)
    seconds = Counter[str]()
    for task, receipt in run_here(plan, selection, threads, after_each).items():
        seconds[task.stage] += receipt.facts["cpu_seconds"]
    return Results(plan.context), seconds


def depths(results: Results) -> dict[str, float]:
    """Errors over the true surface of all source views and frames together: EPE px, its median, share under 1 px, mm,
    their median, coverage.

    Pixels without depth count 16 px and nothing in mm.
    """
    from posegaussian.stages.metrics.depth_error import disparity_error, nearest_pair

    context = results.context
    frames = range(context.grid.frames)
    errors, millimetres, covered = [], [], []
    for view in context.views.sources:
        pair = nearest_pair(context.rig, view, context.views.sources)
        depth, truth, mask = (
            results.read(a, frames, view) for a in (depth_array(context.facts), "truth/depth", "frames/mask")
        )
        for d, t, m in zip(depth, truth, mask, strict=True):
            surface = foreground(m) & (t > 0)
            errors.append(disparity_error(d, t, pair)[surface])
            covered.append(d[surface] > 0)
            millimetres.append(1000 * np.abs(d - t)[surface & (d > 0)])
    epe, mm = np.concatenate(errors), np.concatenate(millimetres)
    return {
        "EPE": float(epe.mean()),
        "EPE median": float(np.median(epe)),
        "1 px": float((epe < 1).mean()),
        "mm": float(mm.mean()),
        "mm median": float(np.median(mm)),
        "coverage": float(np.concatenate(covered).mean()),
    }
