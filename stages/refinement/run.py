"""Kernel of the refinement stage: the first frame of a group rehearses, and every frame of it is trained for as many
steps as that found best."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.refinement.frame import FrameGaussians, FrameReader
from posegaussian.stages.refinement.judging import Judge
from posegaussian.stages.refinement.params import FEWEST, RefinementParams
from posegaussian.stages.refinement.rehearsal import Rehearsal, begin, rehearse
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.steps.attributes import twist_of
from posegaussian.stages.refinement.steps.optimise import Walk
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.sources import REFINED


def run(inputs: Inputs, params: RefinementParams) -> Iterator[Block]:
    """Yield the refined maps of every view, and how each frame went.

    Frames are grouped by their index in the sequence, `params.group` at a time. What a frame is depends on itself and
    on its group's rehearsal, which is done again where the partition begins after it, so results do not depend on how
    the sequence is cut. Views that are no source are 0 throughout; a frame that cannot be refined keeps its maps bit by
    bit.
    """
    frames = FrameReader(inputs, params)
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


def _rehearsed(frames: FrameReader, i: int, frame: FrameGaussians, params: RefinementParams) -> Rehearsal:
    rig, plan = frames.inputs.rig, frame.plan
    assert plan is not None
    lifted = {
        v: lift(frames.maps(i, v), rig.intrinsics[v], rig.world_to_camera[v], torch.float32, torch.device("cpu"))
        for v, _ in plan.neighbours
    }
    judge = Judge.of(frame.filmed[plan.judge], lifted, plan)
    return rehearse(frame.gaussians, frame.filmed, plan, params.steps, params.worth, judge)


def _trained(frame: FrameGaussians, plan: Schedule, steps: int) -> Walk:
    """All views, on all pictures."""
    walk = begin(frame.gaussians, frame.filmed, (*plan.pupils, plan.judge))
    for _ in range(steps):
        walk.step()
    return walk


def _outcome(frame: FrameGaussians, rehearsal: Rehearsal | None, rehearsed: bool, taught: int) -> list[float]:
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
