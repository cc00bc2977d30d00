"""Kernel of the rendering stage: every frame of the partition into every target camera that serves it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.rendering.frame import FrameRenderer, MapReader
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.splatting.definition.scene import Camera


def quantise(values: torch.Tensor) -> np.ndarray:
    """uint8 of values in 0..1, rounded, clipped; what is not a number becomes 0, never a wrapped byte."""
    return torch.round(torch.nan_to_num(values, nan=0.0).clamp(0, 1) * 255).to(torch.uint8).cpu().numpy()


def run(inputs: Inputs, params: RenderingParams) -> Iterator[Block]:
    """Yield color [F, C, H, W, 3] and alpha [F, C, H, W] uint8, premultiplied on black, padded to the largest camera.

    Each frame uses its own maps only. Frames a camera does not serve, and frames without any valid source view, are 0.
    """
    path = inputs.path
    assert path is not None, "rendering runs over a camera path"
    frames, cameras = path.served.shape
    width, height = (int(n) for n in path.size.max(axis=0))
    color, alpha = (
        np.zeros((frames, cameras, height, width, 3), np.uint8),
        np.zeros((frames, cameras, height, width), np.uint8),
    )
    reader, masked = MapReader(inputs), np.zeros((frames, cameras), int)
    for i in range(frames):
        renderer = FrameRenderer(reader, i, params)
        for c in np.nonzero(path.served[i])[0]:
            w, h = (int(n) for n in path.size[c])
            drawn = renderer.picture(Camera(path.intrinsics[i, c], path.world_to_camera[i, c], w, h))
            if drawn is not None:
                color[i, c, :h, :w], alpha[i, c, :h, :w], masked[i, c] = (
                    quantise(drawn[0]),
                    quantise(drawn[1]),
                    drawn[2],
                )
    yield Block("rendering/{path}/color", color, notes=masked_note(masked, inputs.source_frames))
    yield Block("rendering/{path}/alpha", alpha)


def masked_note(masked: np.ndarray, numbers: np.ndarray) -> tuple[str, ...]:
    """A sentence for the frames in which Gaussians were masked: `masked` [F, C] of each picture, `numbers` [F] the
    source's of the frames."""
    most = masked.max(axis=1, initial=0)
    found = np.nonzero(most)[0]
    if not len(found):
        return ()
    others = (
        f"; so were others in {len(found) - 1} more of the frames {numbers[0]}-{numbers[-1]}" if len(found) > 1 else ""
    )
    return (f"{most[found[0]]} Gaussians of frame {numbers[found[0]]} were not finite and were left out{others}",)


def check(block: Block, params: RenderingParams) -> list[str]:
    """Warn when nothing at all was rendered: the cameras look elsewhere, or no source view has depth."""
    data = np.asarray(block.data)
    if block.array.endswith("/alpha") and data.size and not data.any():
        return [
            "every picture of the partition is empty: the cameras look past the subject, or no source view has depth"
        ]
    return []
