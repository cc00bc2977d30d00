"""The smoothing kernel: heatmaps of every view, blended with the frames before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.pose.heatmaps import CELL
from posegaussian.stages.smoothing.filters import blend, stillness
from posegaussian.stages.smoothing.params import SmoothingParams
from posegaussian.storage.model.joint_sets import to_set


def run(inputs: Inputs, params: SmoothingParams) -> Iterator[Block]:
    """Yield smoothing/heatmaps view by view; omega = 1 passes every method's input on bit by bit.

    Scores and speeds come from pose/joints2d, read as COCO-17. The output at frame t depends on frames t-1, t, or
    t-truncation..t for `recurrent`, clipped to the sequence; the first frame of a sequence passes.
    """
    span = inputs.span("pose/heatmaps")
    assert inputs.joint_set is not None, "joints belong to a joint set"
    past = params.truncation if params.method == "recurrent" else 1
    for v in range(len(inputs.rig)):
        heatmaps = inputs.read("pose/heatmaps", v)
        if params.omega == 1:
            yield Block("smoothing/heatmaps", heatmaps[inputs.partition.start - span.start :], v)
            continue
        joints = to_set(inputs.read("pose/joints2d", v), inputs.joint_set, "coco17")
        out = np.empty((len(inputs.partition), *heatmaps.shape[1:]), np.float16)
        for i, frame in enumerate(inputs.partition):
            at = frame - span.start
            window = slice(max(0, at - past), at + 1)
            out[i] = stabilised(heatmaps[window], joints[window], params)
        yield Block("smoothing/heatmaps", out, v)


def stabilised(heatmaps: np.ndarray, joints: np.ndarray, params: SmoothingParams) -> np.ndarray:
    """One frame's output [17, h, w] float32 from a window [n + 1, 17, ...] that ends with it: its heatmaps, and the
    joints (u, v, score) they were drawn of, px."""
    calm = np.ones(heatmaps.shape[1])
    if params.method == "adaptive" and len(heatmaps) == 2:
        calm = stillness(heatmaps, joints, params.speed, CELL)
    omega = 1.0 - (1.0 - params.omega) * calm
    return blend(heatmaps, joints[..., 2].astype(np.float64), omega, calm)


def check(block: Block, params: SmoothingParams) -> list[str]:
    """Raise ValueError for a heatmap value that is not finite or outside 0..1."""
    data = np.asarray(block.data)
    bad = ~((data >= 0) & (data <= 1))
    if bad.any():
        raise ValueError(
            f"{block.array} of view {block.view}: {int(bad.sum())} of {data.size} values lie outside 0..1, the first is"
            f" {data[bad][0]}"
        )
    return []
