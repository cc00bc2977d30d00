"""Seconds of a frame from pictures to pictures by the real pipeline, stage by stage: a simulated person, eight source
views, two held-out pictures a frame, the weights `fast`, all else as it is set by default.

Tasks run one after the other in one process, which sees the device; each ends with arrays on the host, so its seconds
hold all of the device's work, and reading and writing. Stages that cannot use the device run on the CPU beside it.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.gpu.rows import Row, Setup
from benchmarks.quality.cells import Cell, film_cell
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.executors.inline_run import run_here
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import ALL, ARCHIVE, NAME, registered
from posegaussian.dags.training.loop import cores
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.receipts import Receipt

SIDE, FRAMES = 512, 4
SMALLEST = 64
"""Px where figures do not count: survey and judge find somebody in such pictures."""


def rows(setup: Setup) -> Iterator[Row]:
    """A row a stage that ran, in their order, and one of all."""
    frames, threads = (1, 1) if setup.small else (FRAMES, cores())
    limit(threads)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, held_out = film_cell(Cell(1, 8, size=setup.px(SIDE, SMALLEST), frames=frames), folder)
        if not setup.small:  # kernels are compiled on two frames that do not count
            _run(folder, (held_out, "frames.range=0:2"), threads)
            shutil.rmtree(folder / ARCHIVE)
        done = _run(folder, (held_out,), threads)
    side = f"8 views of {SIDE} px"
    for stage in STAGES:
        found = [r.facts for t, r in done.items() if t.stage == stage.name]
        if found:
            on = {setup.name if f["device"] == "cuda" else "the CPU" for f in found}
            seconds = sum(f["seconds"] for f in found) / frames
            yield Row(f"a frame: {stage.name}", side, seconds, "s", ", ".join(sorted(on)))
    whole = sum(r.facts["seconds"] for r in done.values()) / frames
    yield Row("a frame: all stages", side, whole, "s", f"{setup.name} and {threads} threads")


def _run(folder: Path, settings: tuple[str, ...], threads: int) -> dict[Task, Receipt]:
    plan = registered(folder, (*settings, "network.weights=fast")).plan(NAME, ALL)
    return run_here(plan, ALL, threads)
