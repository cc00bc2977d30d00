"""Kernel of the gaussians stage: the analytic prior of every source view, and what the network says over it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.frames.facts import AVERAGED_WITH, NOISE_AVERAGING
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.prior import normals, scales
from posegaussian.stages.imaging.averaging import averaged_depth, sameness
from posegaussian.stages.imaging.noise import noise_at, size_worked_at
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.network.params import NETWORK, QUATERNIONS, SINGLE_OPACITY, TURNED, TWISTED, found_depth_array

CHANNELS = {"gaussians/scale": 3, "gaussians/rotation": 3, "gaussians/opacity": 2, "gaussians/confidence": 1}
"""Maps of one view, in the order they are yielded."""
TWIST = {"gaussians/twist": 2}
"""One more, where weights say whole rotations or along turned axes."""


def run(inputs: Inputs, params: GaussiansParams) -> Iterator[Block]:
    """Yield scale, rotation, opacity and confidence of every view, [F, channel, h, w] float16; while `noise_averaging`
    is on, its averaged depth [F, h, w] float32 m, too.

    Views that are no source, and pixels without confidence, are 0 throughout. The maps' confidence is the share of the
    learned value: 0 where the network does not run. The twist is (1, 0) where nothing turns.
    """
    channels = {**CHANNELS, **(TWIST if TWISTED in inputs.facts else {})}
    width, height = (int(n) for n in inputs.rig.size.max(axis=0))
    steady = NOISE_AVERAGING in inputs.facts
    for view in range(len(inputs.rig)):
        maps = {name: np.zeros((len(inputs.partition), c, height, width), np.float16) for name, c in channels.items()}
        for name in TWIST.keys() & maps.keys():
            maps[name][:, 0] = 1
        depth = np.zeros((len(inputs.partition), height, width), np.float32)
        if view in inputs.views.sources:
            depth, confidence = (_averaged if steady else _found)(inputs, view)
            mask = inputs.read("frames/mask", view)
            said = (
                [inputs.read(f"network/{name}", view) for name in ("numbers", "blend")]
                if NETWORK in inputs.facts
                else None
            )
            turned = {QUATERNIONS: "network/turn", TURNED: "network/axes"} if NETWORK in inputs.facts else {}
            more = {told: inputs.read(name, view) for told, name in turned.items() if told in inputs.facts}
            single = SINGLE_OPACITY in inputs.facts
            for i in range(len(inputs.partition)):
                part = part_around(depth[i] > 0, 0)
                k = inputs.rig.intrinsics[view].copy()
                k[:2, 2] -= part[1].start, part[0].start
                start = prior(depth[i][part], confidence[i][part], mask[i][part], k, params)
                found: tuple[np.ndarray, ...] = start
                if said is not None:
                    # here, because torch takes two seconds to load and nothing else of this stage asks for it
                    from posegaussian.stages.gaussians.learned import over_prior

                    numbers, share = said[0][i][:, *part], said[1][i][part]
                    turn = more[QUATERNIONS][i][:, *part] if QUATERNIONS in more else None
                    axes = more[TURNED][i] if TURNED in more else None
                    found = over_prior(start, numbers, share, k, turn, single, axes)
                # the prior alone has neither a share of the learned value nor a twist
                for name, data in zip(channels, found, strict=False):
                    maps[name][i][:, *part] = data
        for name, data in maps.items():
            yield Block(name, data, view)
        if steady:
            yield Block("gaussians/depth", depth, view)


def _found(inputs: Inputs, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [F, h, w] of a view as each frame has them, with the halo where they are read with one."""
    return inputs.read(found_depth_array(inputs.facts), view), inputs.read("depth/confidence", view)


def _averaged(inputs: Inputs, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [F, h, w] of a view's partition, averaged with the frames around where its pictures show the
    same.

    These pictures are averaged themselves (`posegaussian.stages.imaging.averaging.averaged`): of what stands still they
    differ by a fifth of the noise they were filmed with, of what moved by all of it. Half of it tells the two apart.
    """
    depth, confidence = _found(inputs, view)
    size = size_worked_at(inputs.rig, inputs.source_rig, inputs.captured_to_calibrated)[view]
    noise, color = noise_at(inputs.read("survey/unrest", view), size) / 2, inputs.read("frames/color", view)
    first, footprint = inputs.partition.start - inputs.span("frames/color").start, 1 / inputs.rig.intrinsics[view, 0, 0]
    if noise <= 0:
        own = slice(first, first + len(inputs.partition))
        return depth[own], confidence[own]
    found = []
    for at in range(first, first + len(inputs.partition)):
        start = max(at - AVERAGED_WITH, 0)
        around = slice(start, at + AVERAGED_WITH + 1)
        same = np.stack([sameness(color[at], other, noise) for other in color[around]])
        sure = confidence[around].astype(np.float32)
        found.append(averaged_depth(depth[around], sure, same, at - start, float(footprint)))
    return np.stack([z for z, _ in found]), np.stack([c for _, c in found])


def prior(
    depth: np.ndarray, confidence: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray, params: GaussiansParams
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scale [3, h, w] m, normal [3, h, w] in camera axes and opacity [2, h, w] (face-on, grazing) of one picture,
    float32.

    depth [h, w] m, confidence [h, w] 0..1 and mask [h, w] uint8; what is not finite, not in front of the camera or
    below `params.confidence_min` is no surface and 0 in every map. Opacity is a power of the confidence times the
    covered share of the pixel, because a silhouette's pixel shows the background in part (box PSNR +0.2 dB at 512 px,
    +0.7 at 48 px, true depth). The power is small: where no view is sure, an unsure surface is still better than a hole
    (hull depth, 512 px: box PSNR 25.5 dB with 0.1, 20.8 with 0.5, 15.7 with 1; dropping unsure pixels of matched depth
    costs 2 dB).
    """
    confidence = confidence.astype(np.float32)
    surface = (
        np.isfinite(depth)
        & (depth > 0)
        & np.isfinite(confidence)
        & (confidence > 0)
        & (confidence >= params.confidence_min)
    )
    depth = np.where(surface, depth, 0).astype(np.float32)
    normal = normals(depth, intrinsics)
    scale = scales(depth, normal, intrinsics, params.footprint, params.thickness, params.cosine_min)
    trust = np.where(surface, np.clip(confidence, 0, 1), 0) ** np.float32(params.confidence_power) * surface
    face_on = (params.opacity * trust * (mask / np.float32(255))).astype(np.float32)
    return scale, normal, np.stack([face_on, face_on * np.float32(params.grazing)])


def check(block: Block, params: GaussiansParams) -> list[str]:
    """Warn of frames without any Gaussian; raise ValueError for values that are not finite, not unit, not in range."""
    data = np.asarray(block.data)
    where = f"{block.array} of view {block.view}"
    if not np.isfinite(data).all():
        raise ValueError(f"{where}: {int((~np.isfinite(data)).sum())} values are not finite; every Gaussian must be")
    if block.array in ("gaussians/rotation", *TWIST):
        length = np.sqrt((data.astype(np.float32) ** 2).sum(axis=1))
        off = np.abs(length[length > 0] - 1)
        if off.size and off.max() > 5e-3:  # three float16 components, each within 5e-4 of its value
            what = "turn" if block.array in TWIST else "normal"
            raise ValueError(f"{where}: a {what} of length {1 + off.max():.4f}, bound 1 ± 0.005")
    if block.array == "gaussians/scale" and data.min(initial=0) < 0:
        raise ValueError(f"{where}: a scale of {data.min():g} m, bound 0 m")
    if block.array == "gaussians/opacity" and (data.min(initial=0) < 0 or data.max(initial=0) > 1):
        raise ValueError(f"{where}: opacity {data.min():g}..{data.max():g}, bounds 0..1")
    return []
