"""Steps of refinement on the source pictures of a simulated person, on the device and on one core beside it; what of a
step the renderer takes, both of its pictures with their gradients."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.baselines.splatting import Scene
from benchmarks.gpu.rows import UNMEASURED, Row, Setup
from benchmarks.quality.cells import FLOOR, Cell, film_cell
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.refinement.params import EVERY
from posegaussian.stages.refinement.steps.attributes import ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.steps.optimise import HostWalk
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.splatting.definition.scene import Gaussians
from posegaussian.stages.splatting.gpu.backend import lacks
from posegaussian.stages.splatting.rasterizer import rasterize

STEPS, WARM_UP = 50, 5
SETTINGS = (*FLOOR, "depth.method=hull")


Begun = tuple[dict[int, ViewGaussians], dict[int, Filmed], tuple[int, ...]]
"""What a walk is begun with."""


def begun(folder: Path, size: int) -> Begun:
    """One frame of eight source views."""
    _, held_out = film_cell(Cell(1, 8, size=size, frames=1), folder)
    results, _ = run_capture(folder, (held_out, *SETTINGS))
    scene, rig = Scene.of(results), results.context.rig
    gaussians = {
        v: ViewGaussians.of(thinned(m, EVERY), rig.intrinsics[v], rig.world_to_camera[v]) for v, m in scene.maps.items()
    }
    return gaussians, dict(zip(gaussians, scene.filmed(), strict=True)), tuple(gaussians)


def rows(setup: Setup) -> Iterator[Row]:
    """Of one frame."""
    if lacking := lacks(setup.device):
        yield Row("refinement", "", f"{UNMEASURED}: {lacking}")
        return
    from posegaussian.stages.refinement.steps.on_device import DeviceWalk  # imports Triton

    side = "8 views of 512 px"
    with tempfile.TemporaryDirectory() as folder:
        given = begun(Path(folder), setup.px(512, small=48))
    walk, host = DeviceWalk(*given, setup.device), HostWalk(*given)
    step = _seconds(walk.step, setup)
    yield Row("refinement: steps", side, 1 / step, "a second", setup.name)
    yield Row("refinement: a step", side, 1000 * step, "ms", setup.name)
    yield Row("refinement: a step", side, 1000 * _seconds(host.step, setup), "ms", "one core of the CPU")
    made = walk.there.moved(walk.offsets)
    leaves = Gaussians(*(getattr(made, n).detach().requires_grad_() for n in Gaussians.__dataclass_fields__))

    def drawn() -> None:
        out = rasterize(leaves, [walk.pictures[0].camera])
        (out.color.sum() + out.alpha.sum()).backward()

    share = walk.a_step * _seconds(drawn, setup)
    yield Row("refinement: the renderer's part of a step", side, 1000 * share, "ms", setup.name)
    yield Row("refinement: Gaussians of all views", side, float(len(walk.gaussians)), "")


def _seconds(work: Callable[[], Any], setup: Setup) -> float:
    """Median, with what the device is left to do."""
    times = []
    for _ in range(2 if setup.small else WARM_UP + STEPS):
        begun = time.perf_counter()
        work()
        if setup.device.type == "cuda":
            torch.cuda.synchronize(setup.device)
        times.append(time.perf_counter() - begun)
    return float(np.median(times[1 if setup.small else WARM_UP :]))
