"""Kernel of the refinement stage: frame by frame, each from its own Gaussians or from what the frame before it in
its group learnt."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.refinement.attributes import ViewGaussians
from posegaussian.stages.refinement.judging import Filmed, Judge
from posegaussian.stages.refinement.optimise import Memory, OptimisedFrame, optimise
from posegaussian.stages.refinement.params import RefinementParams
from posegaussian.stages.refinement.schedule import FEWEST, schedule
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.sources import REFINED, unrefined_arrays
from posegaussian.stages.splatting.definition.scene import Camera


def run(inputs: Inputs, params: RefinementParams) -> Iterator[Block]:
    """Yield the refined maps of every view, and how each frame went.

    Frames are grouped by their index in the sequence, `params.group` at a time. What a frame starts from depends on the
    frames before it in its group alone, so those of them that lie before the partition are optimised again; results do
    not depend on how the sequence is cut. Views that are no source are 0 throughout; a frame that cannot be refined
    keeps its maps bit by bit.
    """
    frames = _Frames(inputs)
    first, stop = inputs.partition.start, inputs.partition.stop
    made = {v: [frames.maps(i, v) for i in inputs.partition] for v in inputs.views.sources}
    outcomes = []
    before = Memory()
    for i in range(first // params.group * params.group, stop):
        before = Memory() if i % params.group == 0 else before
        gaussians = frames.usable(i)
        outcome, before = _refined(frames, gaussians, i, params, before)
        if i >= first:
            outcomes.append(outcome.row())
            for v in gaussians if outcome.refined else ():
                made[v][i - first] = gaussians[v].maps()
    nothing = [_nothing(*(int(n) for n in inputs.rig.size.max(axis=0)))] * len(inputs.partition)
    for view in range(len(inputs.rig)):
        for name, arrays in zip(REFINED, zip(*(_arrays(m) for m in made.get(view, nothing)), strict=True), strict=True):
            yield Block(name, np.stack(arrays), view)
    yield Block("refinement/outcome", np.array(outcomes, np.float32).reshape(len(inputs.partition), -1))


def _arrays(maps: GaussianMaps) -> tuple[np.ndarray, ...]:
    """In the order of `REFINED`."""
    return tuple(np.asarray(a) for a in (maps.color, maps.depth, maps.scale, maps.normal, maps.opacity))


def _nothing(width: int, height: int) -> GaussianMaps:
    """The maps of a view that is no source."""
    channels = [np.zeros((c, height, width), np.float16) for c in (3, 3, 2)]
    return GaussianMaps(np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.float32), *channels)


def _refined(
    frames: _Frames, gaussians: dict[int, ViewGaussians], i: int, params: RefinementParams, before: Memory
) -> tuple[OptimisedFrame, Memory]:
    """Optimise the Gaussians of frame `i` in place, where enough views can teach and judge."""
    plan = schedule(
        frames.inputs.rig, frames.inputs.views.sources, np.isin(np.arange(len(frames.inputs.rig)), list(gaussians))
    )
    if plan is None:
        return OptimisedFrame(len(gaussians)), Memory()
    filmed, rig = {v: frames.filmed(i, v) for v in gaussians}, frames.inputs.rig
    lifted = {
        v: lift(frames.maps(i, v), rig.intrinsics[v], rig.world_to_camera[v], torch.float32, torch.device("cpu"))
        for v, _ in plan.neighbours
    }
    return optimise(gaussians, filmed, plan, params.steps, before, Judge.of(filmed[plan.judge], lifted, plan))


class _Frames:
    """What the task reads, frame by frame and view by view; `i` is a frame of the sequence."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self.start = inputs.span("frames/mask").start
        self.arrays = {
            v: [inputs.read(name, v) for name in unrefined_arrays(inputs.facts)] for v in inputs.views.sources
        }
        self.masks = {v: inputs.read("frames/mask", v) for v in inputs.views.sources}

    def maps(self, i: int, view: int) -> GaussianMaps:
        """As they are before refinement."""
        return GaussianMaps(*(a[i - self.start] for a in self.arrays[view]))

    def usable(self, i: int) -> dict[int, ViewGaussians]:
        """Thinned Gaussians of the source views that have some, and something to compare with. Whether a frame of
        the halo has a picture is told by its mask."""
        rig, found = self.inputs.rig, {}
        for v in self.inputs.views.sources:
            gaussians = ViewGaussians(thinned(self.maps(i, v)), rig.intrinsics[v], rig.world_to_camera[v])
            if len(gaussians) and self.masks[v][i - self.start].any():
                found[v] = gaussians
        return found

    def filmed(self, i: int, view: int) -> Filmed:
        """The view's picture without the padding."""
        rig = self.inputs.rig
        width, height = (int(n) for n in rig.size[view])
        cover = self.masks[view][i - self.start][:height, :width].astype(np.float32) / 255
        color = np.asarray(self.maps(i, view).color)[:height, :width].astype(np.float32) / 255 * cover[..., None]
        return Filmed(
            Camera(rig.intrinsics[view], rig.world_to_camera[view], width, height),
            torch.from_numpy(color),
            torch.from_numpy(cover),
        )


def check(block: Block, params: RefinementParams) -> list[str]:
    """Warn of frames that were passed on as they came, and of gradients set to 0; raise ValueError for values that
    are not finite."""
    data = np.asarray(block.data)
    if not np.isfinite(data).all():
        raise ValueError(
            f"{block.array} of view {block.view}: {int((~np.isfinite(data)).sum())} values are not finite; every"
            " refined Gaussian must be. Force the gaussians stage, or set refinement.steps to 0"
        )
    if block.array != "refinement/outcome":
        return []
    ended = (data[:, 4] < params.steps) & (data[:, 3] < data[:, 2])
    few, same, masked = data[:, 0] < FEWEST, ~(data[:, 3] < data[:, 2]), data[:, 6]
    warnings = []
    if few.any():
        warnings.append(
            f"{int(few.sum())} of {len(data)} frames were passed on as they came: fewer than {FEWEST} source views have"
            " a picture, a mask and depth"
        )
    if (same & ~few).any():
        warnings.append(
            f"{int((same & ~few).sum())} of {len(data)} frames were passed on as they came: no step made the judging"
            " view's picture better"
        )
    if ended.any():
        warnings.append(
            f"{int(ended.sum())} of {len(data)} frames are refined by fewer than the {params.steps} steps asked for"
            f" (the median is {int(np.median(data[ended, 4]))}): more made the left-out view's picture no better"
        )
    if masked.any():
        warnings.append(f"{int(masked.sum())} gradients were not finite and were set to 0")
    return warnings
