"""Declaration of the smoothing stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, Facts
from posegaussian.stages.pose.effects import POSE_HEATMAPS
from posegaussian.stages.smoothing.effects import TEMPORAL_SMOOTHING
from posegaussian.stages.smoothing.params import SmoothingParams, halo
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: SmoothingParams) -> Resources:
    """One view's heatmaps in and out, in float32 while they are blended."""
    before, after = halo(params, Facts())
    return Resources(cpu=1, ram=(2 * shape["frame"] + before + after) * 17 * shape["y"] * shape["x"] // 16 * 8)


def unneeded(params: SmoothingParams, facts: Facts) -> str | None:
    """No joints, no heatmaps to smooth; where smoothing is off, readers take the heatmaps as they were drawn."""
    if not {JOINTS2D, JOINTS3D} & facts:
        return "the capture has no joints"
    if POSE_HEATMAPS.name not in facts:
        return "the effect pose_heatmaps is off"
    return None if TEMPORAL_SMOOTHING.name in facts else "the effect temporal_smoothing is off"


STAGE = Stage(
    name="smoothing",
    summary="Stabilise pose heatmaps over time.",
    version=1,
    run="posegaussian.stages.smoothing.run:run",
    check="posegaussian.stages.smoothing.run:check",
    reads=(Read("pose/heatmaps", views="all", halo=halo), Read("pose/joints2d", views="all", halo=halo)),
    writes=(
        ArraySpec(
            "smoothing/heatmaps",
            ("frame", "view", "coco17", "y/4", "x/4"),
            "float16",
            "1",
            "Heatmaps blended over time; the amplitude is the larger score.",
            keep="until_done",
        ),
    ),
    over=("sequence", "time"),
    params=SmoothingParams,
    needs=needs,
    typical=Typical(seconds=1e-7, ratio=0.05),
    unneeded=unneeded,
    effects=(POSE_HEATMAPS, TEMPORAL_SMOOTHING),
)
