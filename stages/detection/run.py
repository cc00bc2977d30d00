"""The detection kernel: an estimator on every source view, then another look where the rig knows better."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.detection.guided import Space, astray
from posegaussian.stages.detection.params import DetectionParams
from posegaussian.stages.estimators.interface import Estimator, Found
from posegaussian.stages.estimators.turned import Turned, quarter_turns
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.imaging.regions import around
from posegaussian.storage.model.joint_sets import joint_set


def run(inputs: Inputs, params: DetectionParams) -> Iterator[Block]:
    """Yield detection/joints2d, region, heatmaps and person of every view; of views that are no sources, and of frames
    a view lacks, zeros.

    Every picture of a source view is looked at by itself, turned upright by quarters where the camera is rolled. Then,
    frame by frame, the person on whom the views agree is projected into those views that did not find that person
    there, and the estimator looks again in that place; what it finds stands beside the others, in place of the least
    clear of too many; a view with a box is left as it is. A result depends on no other frame.
    """
    estimator: Estimator = inputs.source("estimator")
    space = Space(inputs, estimator.joint_set)
    found = {v: _looked(inputs, estimator, params, v) for v in inputs.views.sources}
    boxed = {v for v in found if inputs.views.names[v] in params.box}
    for v, regions in astray(space, found, boxed).items():
        for frame, again in _look_again(inputs, estimator, v, regions):
            first = found[v][frame]
            found[v][frame] = Found.together(
                [again, first.pick(range(min(len(first), params.people - 1)))], len(joint_set(estimator.joint_set))
            )
    for v in range(len(inputs.rig)):
        yield from _blocks(inputs, params, found.get(v), v, len(joint_set(estimator.joint_set)))


def _looked(inputs: Inputs, estimator: Estimator, params: DetectionParams, view: int) -> list[Found]:
    """What the estimator finds in every frame of one view, in the view's box where it has one; nobody where the view
    has no picture."""
    turned = Turned(estimator, quarter_turns(inputs.rig, view))
    present = np.flatnonzero(inputs.valid[:, view])
    out = [Found.nobody(len(joint_set(estimator.joint_set)))] * len(inputs.partition)
    pictures, box = (
        inputs.source("pictures").read(view, [int(n) for n in inputs.source_frames[present]]),
        params.box.get(inputs.views.names[view]),
    )
    for frame, picture in zip(present, pictures, strict=True):
        shown = to_display(picture)
        out[frame] = turned.find(shown, params.people)
        if box is not None:
            inside = out[frame].pick(_inside(out[frame].joints, box))
            out[frame] = inside if len(inside) else turned.look(shown, turned.leaning(around(np.array(box)))[None])
    return out


def _look_again(
    inputs: Inputs, estimator: Estimator, view: int, regions: dict[int, np.ndarray]
) -> Iterator[tuple[int, Found]]:
    """(frame, what is seen in its region [4]) of one view; the picture is decoded again, so that a partition's need
    not be kept."""
    frames = sorted(regions)
    pictures = inputs.source("pictures").read(view, [int(inputs.source_frames[f]) for f in frames])
    for frame, picture in zip(frames, pictures, strict=True):
        yield frame, estimator.look(to_display(picture), regions[frame][None])


def _inside(joints: np.ndarray, box: list[float]) -> list[int]:
    """Which of the people [P, J, 3] have their joints' middle, weighted by score,
    in a box (left, top, right, bottom)."""
    left, top, right, bottom = box
    weight = np.maximum(joints[..., 2:], 1e-6)
    u, v = ((joints[..., :2] * weight).sum(axis=1) / weight.sum(axis=1)).T
    return np.flatnonzero((left <= u) & (u <= right) & (top <= v) & (v <= bottom)).tolist()


def _blocks(
    inputs: Inputs, params: DetectionParams, found: list[Found] | None, view: int, joints: int
) -> Iterator[Block]:
    """The outputs of one view, people padded with nobody; heatmaps only where these joints are the capture's."""
    frames, most = len(inputs.partition), params.people
    shapes = {
        "joints2d": ((joints, 3), np.float32),
        "region": ((4,), np.float32),
        "heatmaps": ((17, 64, 64), np.float16),
        "person": ((256, 256), np.uint8),
    }
    if ESTIMATED not in inputs.facts:
        del shapes["heatmaps"]
    for name, (tail, dtype) in shapes.items():
        data = np.zeros((frames, most, *tail), dtype=dtype)
        for f, people in enumerate(found or ()):
            data[f, : len(people)] = getattr(people, "joints" if name == "joints2d" else name)[:most]
        yield Block(f"detection/{name}", data, view)


def check(block: Block, params: DetectionParams) -> list[str]:
    """Raise ValueError for what is not finite or a score outside 0..1."""
    data = np.asarray(block.data)
    if not np.isfinite(data).all():
        raise ValueError(
            f"{block.array} of view {block.view}:"
            f" {int((~np.isfinite(data)).sum())} of {data.size} values are not finite"
        )
    if block.array == "detection/joints2d" and data.size and not 0 <= data[..., 2].min() <= data[..., 2].max() <= 1:
        raise ValueError(
            f"{block.array} of view {block.view}: scores run from {data[..., 2].min():g} to {data[..., 2].max():g}, the"
            " bounds are 0 and 1"
        )
    return []
