"""Steps of refinement on the source pictures of a simulated person, drawn on the device; what of a step the renderer
takes, both of its pictures with their gradients, and moving Gaussians and pictures to and fro."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.baselines.splatting import Scene
from benchmarks.gpu.rows import Row, Setup
from benchmarks.quality.cells import FLOOR, Cell, film_cell
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.refinement.attributes import ViewGaussians
from posegaussian.stages.refinement.judging import draw
from posegaussian.stages.refinement.loss import Filmed
from posegaussian.stages.refinement.optimise import Walk
from posegaussian.stages.refinement.params import EVERY
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.splatting.definition.scene import Gaussians

STEPS, WARM_UP = 50, 5
SETTINGS = (*FLOOR, "depth.method=hull")


def walk(folder: Path, size: int) -> tuple[Walk, list[Filmed]]:
    """At the start of the steps of one frame, eight source views."""
    _, held_out = film_cell(Cell(1, 8, size=size, frames=1), folder)
    results, _ = run_capture(folder, (held_out, *SETTINGS))
    scene, rig = Scene.of(results), results.context.rig
    gaussians = {
        v: ViewGaussians.of(thinned(m, EVERY), rig.intrinsics[v], rig.world_to_camera[v]) for v, m in scene.maps.items()
    }
    filmed = scene.filmed()
    return Walk(gaussians, dict(zip(gaussians, filmed, strict=True)), tuple(gaussians)), filmed


def rows(setup: Setup) -> Iterator[Row]:
    """Of one frame."""
    side = "8 views of 512 px"
    with tempfile.TemporaryDirectory() as folder:
        walking, filmed = walk(Path(folder), setup.px(512, small=48))
    step = _seconds(walking.step, setup)
    yield Row("refinement: steps", side, 1 / step, "a second", setup.name)
    yield Row("refinement: a step", side, 1000 * step, "ms", setup.name)
    made = walking.gaussians.gaussians()
    leaves = Gaussians(*(getattr(made, n).detach().requires_grad_() for n in Gaussians.__dataclass_fields__))

    def drawn() -> None:
        out = draw(leaves, filmed[0].camera)
        (out.color.sum() + out.alpha.sum()).backward()

    share = walking.a_step * _seconds(drawn, setup)
    yield Row("refinement: the renderer's part of a step", side, 1000 * share, "ms", setup.name)
    yield Row("refinement: Gaussians of all views", side, float(len(walking.gaussians)), "")


def _seconds(work: Callable[[], Any], setup: Setup) -> float:
    """Median; pictures and gradients come back to the host, so that nothing is left to wait for."""
    times = []
    for _ in range(2 if setup.small else WARM_UP + STEPS):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return float(np.median(times[1 if setup.small else WARM_UP :]))
