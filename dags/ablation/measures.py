"""What one run of the pipeline on a simulated sequence says to an ablation:
pictures, their steadiness, depth, joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.dags.diagnostics.held_out_quality import held_out_path
from posegaussian.dags.evaluation.measured import DEVIATION, MEAN
from posegaussian.dags.evaluation.measured import pictures as of_rows
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import depths
from posegaussian.stages.smoothing.facts import TEMPORAL_SMOOTHING

Measured = dict[str, float | None]


LPIPS = "lpips_alex"
"""The metrics stage's name for what the tables call `lpips`."""


def measured(results: Results, joints3d: np.ndarray) -> Measured:
    """Everything, by name; None where there is nothing to say. `joints3d` [F, 17, 3] true COCO-17, metres."""
    found = depths(results)
    depth = {"epe": found["EPE"], "1px": found["1 px"], "depth": found["mm"]}
    return {**pictures(results), **depth, **_joints(results, joints3d)}


def pictures(results: Results) -> Measured:
    """Of the rows of the metrics stage: means over pictures by region, and the change of SSIM in the box over the
    frames of each camera, then over cameras."""
    rows: list[dict[str, Any]] = results.table("metrics/{path}", held_out_path(results.context).name)
    numbers = {n.key: n.value for n in of_rows(rows)}
    found: Measured = {
        f"{measure.removesuffix('_alex')} {region}": value
        for (measure, region, statistic), value in numbers.items()
        if measure in ("psnr", "ssim", LPIPS) and value is not None
    }
    for name, statistic in (("change of ssim", MEAN), ("its deviation", DEVIATION)):
        if numbers.get(("delta_ssim", "box", MEAN)) is not None:
            found[name] = numbers["delta_ssim", "box", statistic]
    return found


def _joints(results: Results, truth: np.ndarray) -> Measured:
    """Of what the heatmaps hold that the network reads, triangulated frame by frame: mm, mm and frames."""
    from posegaussian.stages.pose.jitter import in_space, measures, off_heatmaps

    context = results.context
    array = "smoothing/heatmaps" if TEMPORAL_SMOOTHING in context.facts else "pose/heatmaps"
    if not results.has(array) or len(truth) < 3:
        return {}
    frames, pose, sources = range(context.grid.frames), context.settings.pose, context.views.sources
    seen = np.stack([off_heatmaps(results.read(array, frames, v)) for v in sources], axis=1)
    found = measures(in_space(context.rig.subset(sources), seen, pose.min_score, pose.max_residual), truth)
    return {"joints": found["MPJPE mm"], "jitter": found["jitter mm"], "lag": found["lag frames"]}
