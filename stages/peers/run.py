"""Kernel of the rendering stage: our pictures, or in their place another method's."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch

from posegaussian.stages.contract.io import Block
from posegaussian.stages.contract.timing import TimedInputs
from posegaussian.stages.network.params import depth_array
from posegaussian.stages.peers.fitting import drawn, fitted
from posegaussian.stages.peers.ibr import Photo, around, blended
from posegaussian.stages.rendering.facts import FITTED
from posegaussian.stages.rendering.params import GAUSSIANS, IBR, RenderingParams
from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.rendering.run import run as run_gaussians
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.splatting.definition.scene import Camera

OPTIMISING = "optimising"
"""Module of the kernel, in the receipts: what a frame's own pictures are optimised for."""
Draw = Callable[[Camera], tuple[np.ndarray, np.ndarray]]
"""A target camera -> colour [h, w, 3] sRGB 0..1, premultiplied on black, and alpha [h, w]."""


def run(inputs: TimedInputs, params: RenderingParams) -> Iterator[Block]:
    """Yield color [F, C, H, W, 3] and alpha [F, C, H, W] uint8, premultiplied on black, padded to the largest camera;
    of Gaussians that were fitted to each frame how many there are, [F].

    `params.method` says whose: our own Gaussians, image-based rendering, or 3D Gaussian splatting that is fitted to
    each frame's source pictures alone. Each frame uses its own pictures and maps only. Frames a camera does not serve,
    and frames without any valid source view, are 0.
    """
    if params.method == GAUSSIANS:
        yield from run_gaussians(inputs, params)
        return
    path = inputs.path
    assert path is not None, "rendering runs over a camera path"
    frames, cameras = path.served.shape
    width, height = (int(n) for n in path.size.max(axis=0))
    color = np.zeros((frames, cameras, height, width, 3), np.uint8)
    alpha, counts = np.zeros((frames, cameras, height, width), np.uint8), np.zeros(frames, np.int32)
    for i in np.flatnonzero(path.served.any(axis=1)):
        draw, counts[i] = _prepared(inputs, int(i), params)
        if draw is None:
            continue
        for c in np.flatnonzero(path.served[i]):
            w, h = (int(n) for n in path.size[c])
            picture = draw(Camera(path.intrinsics[i, c], path.world_to_camera[i, c], w, h))
            color[i, c, :h, :w], alpha[i, c, :h, :w] = (quantise(torch.from_numpy(p)) for p in picture)
    yield Block("rendering/{path}/color", color)
    yield Block("rendering/{path}/alpha", alpha)
    if FITTED in inputs.facts:
        yield Block("rendering/{path}/gaussians", counts)


def _prepared(inputs: TimedInputs, i: int, params: RenderingParams) -> tuple[Draw | None, int]:
    """What draws the i-th frame of the partition, None where it has nothing to draw; and of how many Gaussians."""
    photos = _photos(inputs, i)
    if params.method == IBR:
        views = [v for v in inputs.views.sources if inputs.valid[i, v]]
        masks = {v: inputs.read("frames/mask", v, _at(inputs, i))[0] for v in views}
        silhouettes = around(agreed(inputs.rig, masks), photos)
        return (lambda camera: blended(camera, silhouettes, photos)) if photos else None, 0
    with inputs.timed(OPTIMISING):
        gaussians = fitted(photos, params.fit_steps)
    return (None, 0) if gaussians is None else (lambda camera: drawn(gaussians, camera), len(gaussians))


def _at(inputs: TimedInputs, i: int) -> range:
    """The i-th frame of the partition, as arrays are read by."""
    return inputs.partition[i : i + 1]


def _photos(inputs: TimedInputs, i: int) -> list[Photo]:
    """Source views with a picture of the i-th frame, without padding."""
    found, rig = [], inputs.rig
    for v in (v for v in inputs.views.sources if inputs.valid[i, v]):
        w, h = (int(n) for n in rig.size[v])
        arrays = ("frames/color", "frames/mask", depth_array(inputs.facts))
        picture, mask, depth = (inputs.read(a, v, _at(inputs, i))[0][:h, :w] for a in arrays)
        found.append(Photo(Camera(rig.intrinsics[v], rig.world_to_camera[v], w, h), picture, mask, depth))
    return found
