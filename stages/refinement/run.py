"""Kernel of the refinement stage: the first frame of a group rehearses, and every frame of it is trained for as many
steps as that found best; where it found hardly a gain, the next one is asked, too."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.refinement.frame import FrameGaussians, FrameReader
from posegaussian.stages.refinement.judging import Judge
from posegaussian.stages.refinement.params import FEWEST, RefinementParams
from posegaussian.stages.refinement.rehearsal import Rehearsal, begin, rehearse
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.steps.optimise import Walk
from posegaussian.stages.rendering.lift import GaussianMaps, Places, lift
from posegaussian.stages.rendering.sources import COUNTS, REFINED

ASKED = 2
"""Frames of a group, at most, that rehearse while none gains more than chance: one picture that is late, or whose mask
is wrong, would cost the whole group its refinement. Another one a group is what it takes where there is nothing to
gain."""


def run(inputs: Inputs, params: RefinementParams) -> Iterator[Block]:
    """Yield the refined Gaussians of every view as lists, how many they are, and how each frame went.

    Frames are grouped by their index in the sequence, `params.group` at a time. What a frame is depends on itself and
    on its group's rehearsal, which is done again where the partition begins after it, so results do not depend on how
    the sequence is cut. Views that are no source have none; a frame that cannot be refined keeps its Gaussians bit by
    bit.
    """
    frames = FrameReader(inputs, params)
    first, stop = inputs.partition.start, inputs.partition.stop
    made: dict[int, list[GaussianMaps]] = {v: [] for v in inputs.views.sources}
    outcomes = []
    rehearsal: Rehearsal | None = None
    asked = 0
    for i in range(first // params.group * params.group, stop):
        rehearsal, asked = (None, 0) if i % params.group == 0 else (rehearsal, asked)
        settled = rehearsal is not None and (rehearsal.clear or asked == ASKED)
        if i < first and settled:
            continue
        frame = frames.frame(i)
        rehearsed = not settled and frame.plan is not None
        if rehearsed:
            found, asked = _rehearsed(frames, i, frame, params), asked + 1
            rehearsal = found if rehearsal is None or found.gains_more(rehearsal) else rehearsal
        if i < first:
            continue
        taught, lists = 0, dict[int, GaussianMaps]()
        if frame.plan is not None and rehearsal is not None and rehearsal.refines:
            walk = _trained(frame, frame.plan, rehearsal.step)
            taught, lists = walk.masked, walk.reached.lists()
        for v in made:
            made[v].append(lists[v] if v in lists else frames.maps(i, v).listed())
        outcomes.append(_outcome(frame, rehearsal, rehearsed, taught))
    for view in range(len(inputs.rig)):
        own = made.get(view, [_nothing()] * len(inputs.partition))
        yield Block(COUNTS, np.array([np.shape(g.depth)[1] for g in own], np.int32), view)
        for name, arrays in zip(REFINED, zip(*(_arrays(g) for g in own), strict=True), strict=True):
            yield Block(name, _stacked(arrays), view)
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


def _arrays(listed: GaussianMaps) -> tuple[np.ndarray, ...]:
    """[n, ...] in the order of `REFINED`."""
    assert listed.places is not None, "Gaussians are written as lists"
    channels = (a[:, 0].T for a in listed.channels())
    color, depth, pixel = (np.asarray(a)[0] for a in (listed.color, listed.depth, listed.places.pixel))
    return color, depth, *channels, pixel


def _stacked(lists: Sequence[np.ndarray]) -> np.ndarray:
    """[F, n, ...] of [n, ...] each, as long as the longest; 0 where the others have ended."""
    whole = np.zeros((len(lists), max(map(len, lists)), *lists[0].shape[1:]), lists[0].dtype)
    for listed, own in zip(whole, lists, strict=True):
        listed[: len(own)] = own
    return whole


def _nothing() -> GaussianMaps:
    """The list of a view that is no source."""
    three, two = (np.zeros((c, 1, 0), np.float16) for c in (3, 2))
    none = Places(np.zeros((1, 0), np.int32), 1)
    return GaussianMaps(np.zeros((1, 0, 3), np.uint8), np.zeros((1, 0), np.float32), three, three, two, two, two, none)


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
