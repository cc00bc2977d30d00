"""Kernel of the rendering stage: lift the nearest source views of each frame once, render every target camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from stages.geometry.subject import look_at_point
from stages.io import Block, Inputs
from stages.rendering.clipping import retouched, silhouettes_of
from stages.rendering.lift import Lifted, Maps, lift
from stages.rendering.params import RenderingParams
from stages.rendering.rasterizer import Drawing, rasterize
from stages.rendering.scene import Camera, Cutoffs, Gaussians
from stages.rendering.sources import angles_at, choose, map_arrays
from storage.rig import Rig

DTYPES = {"float32": torch.float32, "float64": torch.float64}


def device() -> torch.device:
    """The only place where the device is chosen."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


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
    color, alpha = np.zeros((frames, cameras, height, width, 3), np.uint8), np.zeros((frames, cameras, height, width), np.uint8)
    maps = _MapReader(inputs)
    subject = look_at_point(inputs.rig.subset(inputs.views.sources))
    is_source = np.isin(np.arange(len(inputs.rig)), inputs.views.sources)
    effects = inputs.facts & {"silhouette_clipping", "hole_filling"}
    for i in range(frames):
        silhouettes = silhouettes_of(inputs.rig, maps.masks(i)) if effects else None
        lifted: dict[int, Lifted] = {}
        for c in np.nonzero(path.served[i])[0]:
            w, h = (int(n) for n in path.size[c])
            camera = Camera(path.intrinsics[i, c], path.world_to_camera[i, c], w, h)
            chosen = choose(angles_at(subject, inputs.rig.centres, camera.centre), is_source & inputs.valid[i], params.sources)
            parts = []
            for view, weight in chosen:
                if view not in lifted:
                    lifted[view] = lift(maps.frame(i, view), inputs.rig.intrinsics[view], inputs.rig.world_to_camera[view], DTYPES[params.precision], device())
                seen = lifted[view].seen_from(camera)
                parts.append(replace(seen, opacity=seen.opacity * weight))
            if parts:
                low_pass = widening(camera, inputs.rig, [v for v, _ in chosen], subject) if "anti_aliasing" in inputs.facts else 0.0
                picture = rasterize(Gaussians.concatenate(parts), [camera], drawing=Drawing(Cutoffs(low_pass=low_pass)))
                shown, coverage = picture.color[0], picture.alpha[0]
                if silhouettes is not None:
                    touched = retouched(shown.cpu().numpy(), coverage.cpu().numpy(), silhouettes, camera, "hole_filling" in effects, "silhouette_clipping" in effects)
                    shown, coverage = torch.from_numpy(touched[0]), torch.from_numpy(touched[1])
                color[i, c, :h, :w], alpha[i, c, :h, :w] = quantise(shown), quantise(coverage)
    yield Block("rendering/{path}/color", color)
    yield Block("rendering/{path}/alpha", alpha)


def widening(camera: Camera, rig: Rig, views: list[int], subject: np.ndarray) -> float:
    """Variance, px^2, by which Gaussians are widened in a picture that samples the subject [3] more coarsely than the finest of its source views.

    3DGS adds 0.3 px^2 to every Gaussian. Here it is 0.3 (1 - 1 / r^2), r the size of the picture's pixels in the source's: Gaussians as
    wide as a pixel need nothing, and ever narrower ones come to 0.3.
    """
    def pixel(intrinsics: np.ndarray, centre: np.ndarray) -> float:
        return float(np.linalg.norm(centre - subject)) / float(intrinsics[[0, 1], [0, 1]].mean())

    ratio = pixel(camera.intrinsics, camera.centre) / min(pixel(rig.intrinsics[v], rig.centres[v]) for v in views)
    return 0.3 * max(0.0, 1 - ratio**-2)


class _MapReader:
    """Reads a view's maps when a target first asks for them."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self.views: dict[int, tuple[np.ndarray, ...]] = {}
        self.silhouettes: dict[int, np.ndarray] = {}

    def frame(self, i: int, view: int) -> Maps:
        """Maps of the i-th frame of the partition."""
        if view not in self.views:
            self.views[view] = tuple(self.inputs.read(name, view) for name in map_arrays(self.inputs.facts))
        return Maps(*(a[i] for a in self.views[view]))

    def masks(self, i: int) -> dict[int, np.ndarray]:
        """Masks of the i-th frame by source view that has a picture."""
        if not self.silhouettes:
            self.silhouettes = {v: self.inputs.read("frames/mask", v) for v in self.inputs.views.sources}
        return {v: m[i] for v, m in self.silhouettes.items() if self.inputs.valid[i, v]}


def check(block: Block, params: RenderingParams) -> list[str]:
    """Warn when nothing at all was rendered: the cameras look elsewhere, or no source view has depth."""
    data = np.asarray(block.data)
    if block.array.endswith("/alpha") and data.size and not data.any():
        return ["every picture of the partition is empty: the cameras look past the subject, or no source view has depth"]
    return []
