"""What one run of the pipeline on a simulated sequence says to an ablation:
pictures, their steadiness, depth, joints."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import depths
from posegaussian.dags.tradeoff.quality import held_out_path
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
    """Of the rows of the metrics stage: means over pictures;
    the change of SSIM over the frames of each camera, then over cameras."""
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    changes: dict[str, list[float]] = defaultdict(list)
    rows: list[dict[str, Any]] = results.table("metrics/{path}", held_out_path(results.context).name)
    for row in rows:
        if row["measure"] in ("psnr", "ssim", LPIPS) and row["value"] is not None:
            values[row["measure"].removesuffix("_alex"), row["region"]].append(row["value"])
        elif (row["measure"], row["region"]) == ("delta_ssim", "box"):
            changes[row["camera"]].append(row["value"])
    means: Measured = {f"{name} {region}": float(np.mean(v)) for (name, region), v in values.items()}
    if not changes:
        return means
    return {
        **means,
        "change of ssim": float(np.mean([np.mean(v) for v in changes.values()])),
        "its deviation": float(np.mean([np.std(v) for v in changes.values()])),
    }


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
