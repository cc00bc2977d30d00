"""Depth and confidence of every source view, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from stages.depth.estimate import estimate, estimate_open
from stages.depth.limbs import limbs_of
from stages.depth.params import DepthParams, refusal
from stages.depth.scene import Frame, Geometry, Maps, has_silhouettes, hull_only
from stages.depth.sweeping import sweep_hull, sweep_open
from stages.io import Block, Inputs
from storage.errors import UserError
from storage.joints import to_set
from storage.rig import Rig

FEW_MATCHES = 0.3
"""Share of the surface below which a view is reported as poorly matched."""


def run(inputs: Inputs, params: DepthParams) -> Iterator[Block]:
    """Blocks `depth/depth` and `depth/confidence` of every view; views that are not sources get zeros.

    Each frame follows from its own pictures, masks and valid views alone. While `left_right_check` is off, a match counts
    whatever the other view says; while `limb_bounds` is on, the hull's near side follows the joints. Raises UserError for `method: truth` without
    true depth.
    """
    reason = refusal(params, inputs.facts)
    if reason:
        raise UserError(reason)
    if params.method == "truth":
        yield from _truth(inputs)
        return
    sources = inputs.views.sources
    masks = {v: inputs.read("frames/mask", v) for v in sources}
    colors = {v: inputs.read("frames/color", v) for v in sources} if params.method != "hull" else {}
    shape, limbs = _shape(inputs), _limbs(inputs)
    depth = {v: np.zeros(shape, np.float32) for v in sources}
    confidence = {v: np.zeros(shape, np.float16) for v in sources}

    @cache
    def geometry(valid: tuple[int, ...], enlarge: bool) -> Geometry:
        return Geometry.of(inputs.rig, valid, params, enlarge)

    for f in range(shape[0]):
        valid = tuple(v for v in sources if inputs.valid[f, v])
        frame = Frame({v: colors[v][f] for v in valid if v in colors}, {v: masks[v][f] for v in valid}, limbs[f])
        for v, (z, c) in _depth(geometry, frame, params, inputs.rig, "left_right_check" in inputs.facts).items():
            depth[v][f], confidence[v][f] = z, c
    for v in range(len(inputs.rig)):
        yield Block("depth/depth", depth.get(v, np.zeros(shape, np.float32)), v)
        yield Block("depth/confidence", confidence.get(v, np.zeros(shape, np.float16)), v)


def _depth(geometry: Callable[[tuple[int, ...], bool], Geometry], frame: Frame, params: DepthParams, rig: Rig, checked: bool) -> Maps:
    """Depth and confidence of one frame, by what there is to go by."""
    views, silhouettes = tuple(frame.masks), has_silhouettes(rig, frame.masks)
    if params.method == "hull":
        return hull_only(geometry(views, False), frame)
    kernels = {"sgbm": (estimate, estimate_open), "sweep": (sweep_hull, sweep_open)}[params.method]
    return kernels[not silhouettes](geometry(views, silhouettes), frame, params, checked)


def _shape(inputs: Inputs) -> tuple[int, int, int]:
    """(frames, height, width) of the arrays: pictures are padded to the largest."""
    width, height = inputs.rig.size.max(axis=0)
    return len(inputs.partition), int(height), int(width)


def _limbs(inputs: Inputs) -> list[np.ndarray]:
    """[N, 7] capsules of each frame; none while `limb_bounds` is off."""
    if "limb_bounds" not in inputs.facts or inputs.joint_set is None:
        return [np.zeros((0, 7))] * len(inputs.partition)
    return [limbs_of(j) for j in to_set(inputs.read("pose/joints3d"), inputs.joint_set, "coco17")]


def _truth(inputs: Inputs) -> Iterator[Block]:
    for v in range(len(inputs.rig)):
        depth = np.zeros(_shape(inputs), np.float32)
        if v in inputs.views.sources:
            depth[inputs.valid[:, v]] = inputs.read("truth/depth", v)[inputs.valid[:, v]]
        yield Block("depth/depth", depth, v)
        yield Block("depth/confidence", (depth > 0).astype(np.float16), v)


def check(block: Block, params: DepthParams) -> list[str]:
    """Warn of a view that matching could hardly serve; raise ValueError for values that no depth or confidence can have."""
    bound = np.inf if block.array == "depth/depth" else 1.0
    data = np.asarray(block.data)
    wrong = ~(np.isfinite(data) & (data >= 0) & (data <= bound))
    if wrong.any():
        raise ValueError(f"{block.array} of view {block.view}: {int(wrong.sum())} values such as {data[wrong][0]} are not in [0, {bound:g}]")
    if block.array != "depth/confidence" or params.method not in ("sgbm", "sweep") or not data.any():
        return []
    matched = float((data >= 0.5).sum() / (data > 0).sum())
    if matched >= FEW_MATCHES:
        return []
    return [f"view {block.view}: {matched:.0%} of the surface was matched with another view (at least {FEW_MATCHES:.0%} expected); the rest follows neighbours and the hull"]
