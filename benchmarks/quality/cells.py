"""One benchmark scene, filmed and run by the real pipeline with several kinds of depth,
and what is measured of each."""

from __future__ import annotations

import shutil
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.error_places import PLACES, squared_error_by_place
from benchmarks.quality.light import fitted
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import depths, film_capture, held_out_setting, run_capture
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.geometry.consistency import (
    change_across,
    photometric_disagreement,
    reprojection_residual,
    typical_offset,
)
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.network.choice import weights_choice
from posegaussian.stages.network.params import depth_array
from posegaussian.stages.simulator.capture_scenes import CAPTURE_LIKE_SEEDS, capture_like_scene
from posegaussian.stages.simulator.quality_scenes import REPORTING_SEEDS, benchmark_scene
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.model.masks import foreground
from posegaussian.storage.readers.images import read_mask

WEIGHTS = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of RGB (BT.709)."""
SCENES = {"plain": tuple(REPORTING_SEEDS), "capture_like": tuple(CAPTURE_LIKE_SEEDS)}
"""{set of scenes: its seeds for reporting}: matt people bare-handed on upright rings, and scenes that are like captures
(`posegaussian.stages.simulator.capture_scenes`)."""
TIMED = ("judge", "depth", "network", "gaussians", "refinement", "rendering")
UNREFINED = ("refinement.steps=0",)
"""Pictures from depth and Gaussians as they are made."""
FLOOR = ("network.weights=none", *UNREFINED)
"""The analytic floor: by geometry alone."""
DEFAULT, LEARNED = "default", "network"
"""In place of a depth method: everything as it is set by default, depth and network by the judge's choice, and refined;
and the same with the weights that ship, whatever the judge says of them, unrefined."""
SETTINGS = {DEFAULT: (), LEARNED: ("network.weights=fast", *UNREFINED)}
"""{what stands in place of a depth method: its settings}."""


@dataclass(frozen=True)
class Cell:
    """A scene of the benchmark."""

    seed: int
    cameras: int | None
    """None: as many as the scene itself has."""
    variant: str = "clean"
    size: int = 512
    frames: int = 3
    """At most: some scenes have a single one."""
    held_out: int = 2
    scenes: str = "plain"
    """Name in `SCENES`."""

    @cached_property
    def scene(self) -> Scene:
        """What is filmed."""
        if self.scenes == "capture_like":
            return capture_like_scene(self.seed, self.cameras, self.size, self.frames, self.held_out)
        return benchmark_scene(self.seed, self.cameras or 8, self.size, self.frames, self.variant, self.held_out)


def measure_cell(
    cell: Cell, methods: tuple[str, ...], folder: Path, settings: tuple[str, ...] = ()
) -> list[dict[str, Any]]:
    """One row for every method; `folder` is removed afterwards. Raises RunFailed when a task fails."""
    motion, held_out = film_cell(cell, folder)
    rows = []
    for method in methods:
        chosen = SETTINGS.get(method, (*FLOOR, f"depth.method={method}"))
        results, seconds = run_capture(folder, (held_out, *chosen, *settings))
        context = results.context
        per_frame = {f"{s} s": seconds[s] / cell.scene.frames for s in TIMED}
        rows.append(
            {
                "seed": cell.seed,
                "scenes": cell.scenes,
                "motion": motion,
                "cameras": cell.scene.rig.cameras,
                "variant": cell.variant,
                "depth": method,
                "method": resolve_method(context.settings.depth, context.facts).name,
                "weights": weights_choice(context.settings.network, context.facts)[0],
                **pictures(results, cell),
                **depths(results),
                **_agreement(results, cell),
                **per_frame,
            }
        )
    shutil.rmtree(folder)
    return rows


def film_cell(cell: Cell, folder: Path) -> tuple[str, str]:
    """Film the scene into `folder`; the motion's name, and the setting that keeps its middle cameras aside."""
    staged, _ = film_capture(cell.scene, folder)
    return cell.scene.motion.name, held_out_setting(staged)


def pictures(results: Results, cell: Cell, filmed: Path | None = None) -> dict[str, Any]:
    """Means over held-out pictures; error shares of all of them together; one picture for the eye. Where the run was
    given no masks, those of the capture that was `filmed` tell who is the subject.

    Cameras of scenes like captures expose differently: their pictures are brought to the held-out camera's light."""
    context, frames = results.context, range(results.context.grid.frames)
    (path,) = context.paths.values()
    color, alpha = (results.read(f"rendering/{path.name}/{a}", frames) for a in ("color", "alpha"))
    found: dict[str, list[float]] = defaultdict(list)
    error = np.zeros(len(PLACES))
    shown: list[np.ndarray] = []
    for c, name in enumerate(path.names):
        view = context.rig.index(name)
        truth = results.read("frames/color", frames, view)
        mask = _filmed_masks(filmed / "masks" / name) if filmed else results.read("frames/mask", frames, view)
        for i in frames:
            if cell.scenes == "capture_like":
                color[i, c] = np.rint(fitted(color[i, c], truth[i], mask[i])[0])
            for (region, m), value in measure(color[i, c], truth[i], mask[i], context.settings.metrics).items():
                assert isinstance(value, float), value
                found[f"{region} {m}"].append(value)
            inside = foreground(mask[i])
            found["luminance"].append(
                float(np.abs((color[i, c].astype(np.float64) - truth[i])[inside] @ WEIGHTS).mean())
            )
            error += squared_error_by_place(color[i, c], alpha[i, c], truth[i], mask[i])
        shown.append(np.stack([color[-1, c], (truth[-1] * (mask[-1][..., None] / 255.0)).astype(np.uint8)]))
    return {
        **{k: float(np.mean(v)) for k, v in found.items()},
        **dict(zip(PLACES, (error / error.sum()).tolist(), strict=True)),
        "shown": shown[0],
    }


def _filmed_masks(folder: Path) -> np.ndarray:
    """[F, h, w] uint8 of one camera."""
    return np.stack([read_mask(file) for file in sorted(folder.iterdir())])


def _agreement(results: Results, cell: Cell) -> dict[str, float]:
    """What the capture says about itself, without truth:
    medians over joints, points, outlines (see stages/geometry/consistency)."""
    context, frames = results.context, range(results.context.grid.frames)
    rig, sources = context.rig, context.views.sources
    seen, world = (
        np.stack([results.read("frames/color", frames, v) for v in sources], 1),
        results.read("pose/joints3d", frames),
    )
    masks, depths = (
        np.stack([results.read(a, frames, v) for v in sources], 1) for a in ("frames/mask", depth_array(context.facts))
    )
    joints = np.stack([results.read("pose/joints2d", frames, v) for v in sources], 1)
    subset = rig.subset(sources)
    residuals = [reprojection_residual(subset, joints[i], world[i]) for i in frames]
    apart = [
        photometric_disagreement(subset, (a, b), (seen[i, a], seen[i, b]), (depths[i, a], depths[i, b]))
        for i in frames
        for a, b in ((k, (k + 1) % len(sources)) for k in range(len(sources)))
    ]
    outlines = [change_across(seen[i, v], masks[i, v]) for i in frames for v in range(len(sources))]
    decision = context.effects["outline_correction"].decision
    given = decision.measured if decision is not None and decision.measured is not None else float("nan")
    return {
        "given outline px": given,
        "joints px": float(np.median(np.concatenate(residuals))),
        "photo": float(np.concatenate(apart).mean()),
        "outline px": typical_offset(np.concatenate(outlines)),
    }
