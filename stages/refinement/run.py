"""Kernel of the refinement stage: the first frame of a group rehearses, and every frame of it is trained for as many
steps as that found best."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.refinement.judging import Judge
from posegaussian.stages.refinement.params import FEWEST, RefinementParams, pixels_a_gaussian
from posegaussian.stages.refinement.rehearsal import Rehearsal, begin, rehearse
from posegaussian.stages.refinement.schedule import Schedule, schedule
from posegaussian.stages.refinement.steps.attributes import ViewGaussians, twist_of
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.steps.optimise import Walk
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.sources import REFINED, unrefined_arrays
from posegaussian.stages.splatting.definition.scene import Camera


def run(inputs: Inputs, params: RefinementParams) -> Iterator[Block]:
    """Yield the refined maps of every view, and how each frame went.

    Frames are grouped by their index in the sequence, `params.group` at a time. What a frame is depends on itself and
    on its group's rehearsal, which is done again where the partition begins after it, so results do not depend on how
    the sequence is cut. Views that are no source are 0 throughout; a frame that cannot be refined keeps its maps bit by
    bit.
    """
    frames = _Frames(inputs, params)
    first, stop = inputs.partition.start, inputs.partition.stop
    made = {v: [frames.maps(i, v) for i in inputs.partition] for v in inputs.views.sources}
    outcomes = []
    rehearsal: Rehearsal | None = None
    for i in range(first // params.group * params.group, stop):
        rehearsal = None if i % params.group == 0 else rehearsal
        if i < first and rehearsal is not None:
            continue
        frame = frames.frame(i)
        rehearsed = rehearsal is None and frame.plan is not None
        rehearsal = _rehearsed(frames, i, frame, params) if rehearsed else rehearsal
        if i < first:
            continue
        taught = 0
        if frame.plan is not None and rehearsal is not None and rehearsal.refines:
            walk = _trained(frame, frame.plan, rehearsal.step)
            taught = walk.masked
            for v, maps in walk.reached.maps().items():
                made[v][i - first] = maps
        outcomes.append(_outcome(frame, rehearsal, rehearsed, taught))
    nothing = [_nothing(*(int(n) for n in inputs.rig.size.max(axis=0)))] * len(inputs.partition)
    for view in range(len(inputs.rig)):
        for name, arrays in zip(REFINED, zip(*(_arrays(m) for m in made.get(view, nothing)), strict=True), strict=True):
            yield Block(name, np.stack(arrays), view)
    yield Block("refinement/outcome", np.array(outcomes, np.float32).reshape(len(inputs.partition), -1))


class _Frame(NamedTuple):
    """What is optimised, and on what, by source view that has both."""

    gaussians: dict[int, ViewGaussians]
    filmed: dict[int, Filmed]
    plan: Schedule | None
    """None: too few views."""


def _rehearsed(frames: _Frames, i: int, frame: _Frame, params: RefinementParams) -> Rehearsal:
    rig, plan = frames.inputs.rig, frame.plan
    assert plan is not None
    lifted = {
        v: lift(frames.maps(i, v), rig.intrinsics[v], rig.world_to_camera[v], torch.float32, torch.device("cpu"))
        for v, _ in plan.neighbours
    }
    judge = Judge.of(frame.filmed[plan.judge], lifted, plan)
    return rehearse(frame.gaussians, frame.filmed, plan, params.steps, params.worth, judge)


def _trained(frame: _Frame, plan: Schedule, steps: int) -> Walk:
    """All views, on all pictures."""
    walk = begin(frame.gaussians, frame.filmed, (*plan.pupils, plan.judge))
    for _ in range(steps):
        walk.step()
    return walk


def _outcome(frame: _Frame, rehearsal: Rehearsal | None, rehearsed: bool, taught: int) -> list[float]:
    """As `refinement/outcome` holds it."""
    if frame.plan is None or rehearsal is None:
        return [len(frame.gaussians), -1, 0, 0, 0, 0, 0, 0]
    r = rehearsal
    masked = taught + (r.masked if rehearsed else 0)
    return [len(frame.gaussians), r.judge, r.before, r.after, r.step, rehearsed, masked, r.share]


def _arrays(maps: GaussianMaps) -> tuple[np.ndarray, ...]:
    """In the order of `REFINED`."""
    given = maps.color, maps.depth, maps.scale, maps.normal, maps.opacity
    return *(np.asarray(a) for a in given), twist_of(maps)


def _nothing(width: int, height: int) -> GaussianMaps:
    """The maps of a view that is no source."""
    channels = [np.zeros((c, height, width), np.float16) for c in (3, 3, 2, 2)]
    return GaussianMaps(np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.float32), *channels)


class _Frames:
    """What the task reads, frame by frame and view by view; `i` is a frame of the sequence."""

    def __init__(self, inputs: Inputs, params: RefinementParams) -> None:
        self.inputs, self.every = inputs, pixels_a_gaussian(len(inputs.views.sources), params)
        self.start = inputs.span("frames/mask").start
        self.arrays = {
            v: [inputs.read(name, v) for name in unrefined_arrays(inputs.facts)] for v in inputs.views.sources
        }
        self.masks = {v: inputs.read("frames/mask", v) for v in inputs.views.sources}

    def maps(self, i: int, view: int) -> GaussianMaps:
        """As they are before refinement."""
        return GaussianMaps(*(a[i - self.start] for a in self.arrays[view]))

    def frame(self, i: int) -> _Frame:
        """Thinned Gaussians of the source views that have some, and something to compare with. Whether a frame of
        the halo has a picture is told by its mask."""
        rig, sources = self.inputs.rig, self.inputs.views.sources
        found = {}
        for v in sources:
            maps = thinned(self.maps(i, v), self.every)
            gaussians = ViewGaussians.of(maps, rig.intrinsics[v], rig.world_to_camera[v])
            if len(gaussians) and self.masks[v][i - self.start].any():
                found[v] = gaussians
        plan = schedule(rig, sources, np.isin(np.arange(len(rig)), list(found)))
        return _Frame(found, {v: self.filmed(i, v) for v in found} if plan else {}, plan)

    def filmed(self, i: int, view: int) -> Filmed:
        """The view's picture without the padding."""
        rig = self.inputs.rig
        width, height = (int(n) for n in rig.size[view])
        cover = self.masks[view][i - self.start][:height, :width].astype(np.float32) / 255
        color = np.asarray(self.maps(i, view).color)[:height, :width].astype(np.float32) / 255 * cover[..., None]
        return Filmed(Camera(rig.intrinsics[view], rig.world_to_camera[view], width, height), color, cover)


def check(block: Block, params: RefinementParams) -> list[str]:
    """Warn of frames that were passed on as they came, of gradients set to 0, and of fewer steps than asked for where
    any gain is worth one; raise ValueError for values that are not finite."""
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
    if ended.any() and params.worth == 0:
        warnings.append(
            f"{int(ended.sum())} of {len(data)} frames are refined by fewer than the {params.steps} steps asked for"
            f" (the median is {int(np.median(data[ended, 4]))}): more made the left-out view's picture no better"
        )
    if masked.any():
        warnings.append(f"{int(masked.sum())} gradients were not finite and were set to 0")
    return warnings
