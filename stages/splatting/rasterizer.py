"""Gaussians and cameras in, pictures out: the one way to the back ends.

`reference` is plain torch in the dtype and on the device of the Gaussians; `cpu` is numba, `gpu` is Triton, both in
float32. All composite by the same definition with the same cut-offs (`reference.py` states it) and are differentiable
in the Gaussians and the cameras.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cache

import torch

from posegaussian.stages.splatting.arguments import check
from posegaussian.stages.splatting.definition import reference
from posegaussian.stages.splatting.definition.scene import Backend, Camera, Drawing, Gaussians, Rendering
from posegaussian.stages.splatting.gpu import backend as gpu

log = logging.getLogger(__name__)


def rasterize(
    gaussians: Gaussians, cameras: Sequence[Camera], extras: Sequence[str] = (), drawing: Drawing | None = None
) -> Rendering:
    """Render Gaussians into C cameras of one size.

    extras: any of "depth" and "normal", drawn only when asked for. Any N and any picture size are valid; an empty scene
    gives zeros. Gaussians that are not finite are masked and counted and reach neither a picture nor a gradient.
    Opacities and colours are not checked for their range. Raises ValueError for what no back end can draw; it names the
    argument, its value and what to do.
    """
    drawing = drawing or Drawing()
    check(gaussians, cameras, extras, drawing)
    backend = resolve(drawing.backend, gaussians)
    pictures = [_draw(gaussians, camera, extras, drawing, backend) for camera in cameras]
    picture, alpha = _stacked([p[0] for p in pictures]), _stacked([p[1] for p in pictures])
    depth = picture[..., 3] if "depth" in extras else None
    normal = picture[..., 4:7] if "normal" in extras else None
    color = picture[..., :3] if extras else picture
    return Rendering(color, alpha, depth, normal, tuple(p[2] for p in pictures), backend)


def _stacked(pictures: list[torch.Tensor]) -> torch.Tensor:
    """[C, ...]; a single picture is not copied."""
    return pictures[0][None] if len(pictures) == 1 else torch.stack(pictures)


def resolve(backend: Backend, gaussians: Gaussians) -> str:
    """The back end that draws these Gaussians."""
    if backend != "auto":
        return backend
    device = gaussians.mean.device
    if gaussians.mean.dtype != torch.float32 or device.type not in ("cpu", "cuda"):
        return "reference"
    if device.type == "cpu":
        return "cpu"
    if lacking := gpu.lacks(device):
        _say_once(lacking)
    return "reference" if lacking else "gpu"


@cache
def _say_once(lacking: str) -> None:
    log.warning("rendering on the GPU by the `reference` back end, slowly, because %s", lacking)


def _draw(
    gaussians: Gaussians, camera: Camera, extras: Sequence[str], drawing: Drawing, backend: str
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """(picture [h, w, 3, 4 or 7] = colour, depth, normal; alpha [h, w]; masked)."""
    channels = 7 if "normal" in extras else 4 if "depth" in extras else 3
    if backend == "gpu":
        return gpu.render(gaussians, camera, drawing.cutoffs, channels)
    if backend == "cpu":
        from posegaussian.stages.splatting.cpu import backend as cpu

        return cpu.render(gaussians, camera, drawing.cutoffs, channels, drawing.threads)
    picture, masked = reference.composite(gaussians, camera, drawing.cutoffs)
    return (
        torch.cat([picture[..., :3], picture[..., 4:]], dim=2) if extras else picture[..., :3],
        picture[..., 3],
        masked,
    )
