"""Gaussians and cameras in, pictures out: the one way to the back ends.

`reference` is plain torch in the dtype and on the device of the Gaussians; `cpu` is numba, `gpu` is Triton, both in float32.
All composite by the same definition with the same cut-offs (`reference.py` states it) and are differentiable in the
Gaussians and the cameras.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import get_args

import torch

from stages.rendering import gpu, reference
from stages.rendering.params import Backend
from stages.rendering.scene import Camera, Cutoffs, Gaussians, Rendering

log = logging.getLogger(__name__)
EXTRAS = ("depth", "normal")
"""Pictures beside colour and alpha."""
SHAPES = {"mean": (3,), "rotation": (3, 3), "scale": (3,), "opacity": (), "color": (3,)}
"""Of one Gaussian."""


@dataclass(frozen=True)
class Drawing:
    """How to draw."""

    cutoffs: Cutoffs = field(default_factory=Cutoffs)
    """Thresholds."""
    backend: Backend = "auto"
    """`auto`: for float32 Gaussians `cpu` on the CPU and `gpu` on a CUDA device where Triton is there, else `reference`."""
    threads: int = 1
    """Threads of the `cpu` back end; the result does not depend on it."""


def rasterize(gaussians: Gaussians, cameras: Sequence[Camera], extras: Sequence[str] = (), drawing: Drawing | None = None) -> Rendering:
    """Render Gaussians into C cameras of one size.

    extras: any of `EXTRAS`, drawn only when asked for. Any N and any picture size are valid; an empty scene gives zeros.
    Gaussians that are not finite are masked and counted and reach neither a picture nor a gradient. Opacities and colours
    are not checked for their range. Raises ValueError for what no back end can draw; it names the argument, its value and
    what to do.
    """
    drawing = drawing or Drawing()
    _check(gaussians, cameras, extras, drawing)
    backend = resolve(drawing.backend, gaussians)
    pictures = [_draw(gaussians, camera, extras, drawing, backend) for camera in cameras]
    picture, alpha = (_stacked([p[i] for p in pictures]) for i in (0, 1))
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


def _draw(gaussians: Gaussians, camera: Camera, extras: Sequence[str], drawing: Drawing, backend: str) -> tuple[torch.Tensor, torch.Tensor, int]:
    """(picture [h, w, 3, 4 or 7] = colour, depth, normal; alpha [h, w]; masked)."""
    channels = 7 if "normal" in extras else 4 if "depth" in extras else 3
    if backend == "gpu":
        return gpu.render(gaussians, camera, drawing.cutoffs, channels)
    if backend == "cpu":
        from stages.rendering import cpu

        return cpu.render(gaussians, camera, drawing.cutoffs, channels, drawing.threads)
    picture, masked = reference.composite(gaussians, camera, drawing.cutoffs)
    return torch.cat([picture[..., :3], picture[..., 4:]], dim=2) if extras else picture[..., :3], picture[..., 3], masked


def _check(gaussians: Gaussians, cameras: Sequence[Camera], extras: Sequence[str], drawing: Drawing) -> None:
    """Everything that cannot be drawn, before anything is."""
    if isinstance(cameras, Camera) or not cameras:
        raise ValueError(f"cameras = {cameras!r}: pass a list of one or more cameras, also for a single one")
    sizes = sorted({(c.width, c.height) for c in cameras})
    if len(sizes) > 1:
        raise ValueError(f"cameras of {len(sizes)} sizes, {sizes[0]} and {sizes[1]} px: their pictures make no array; call once a size")
    if min(sizes[0]) < 1:
        raise ValueError(f"cameras of {sizes[0][0]} x {sizes[0][1]} px: a picture has at least one pixel")
    for camera in cameras:
        if tuple(camera.intrinsics.shape) != (3, 3) or tuple(camera.world_to_camera.shape) != (4, 4):
            raise ValueError(f"camera.intrinsics {tuple(camera.intrinsics.shape)}, camera.world_to_camera {tuple(camera.world_to_camera.shape)}: (3, 3) and (4, 4) are needed")
        for name, matrix in (("intrinsics", camera.intrinsics), ("world_to_camera", camera.world_to_camera)):
            if not bool(torch.isfinite(torch.as_tensor(matrix)).all()):
                raise ValueError(f"camera.{name} holds numbers that are not finite: {matrix.tolist()}; nothing can be drawn, mend the calibration")
    for extra in extras:
        if extra not in EXTRAS:
            raise ValueError(f"extras has {extra!r}: choose from {', '.join(EXTRAS)}; colour and alpha are always drawn")
    n, dtype, device = len(gaussians), gaussians.mean.dtype, gaussians.mean.device
    for name, shape in SHAPES.items():
        values = getattr(gaussians, name)
        if tuple(values.shape) != (n, *shape):
            raise ValueError(f"gaussians.{name} has shape {tuple(values.shape)}: {(n, *shape)} is needed beside {n} means")
        if (values.dtype, values.device) != (dtype, device):
            raise ValueError(f"gaussians.{name} is {values.dtype} on {values.device}, gaussians.mean is {dtype} on {device}: convert one of them")
    if dtype not in (torch.float32, torch.float64):
        raise ValueError(f"gaussians.mean is {dtype}: convert the Gaussians to float32 or float64")
    if drawing.backend not in get_args(Backend):
        raise ValueError(f"drawing.backend = {drawing.backend!r}: choose from {', '.join(get_args(Backend))}")
    if drawing.backend == "cpu" and (dtype, device.type) != (torch.float32, "cpu"):
        raise ValueError(f"drawing.backend = 'cpu' with {dtype} Gaussians on {device}: it draws float32 on the CPU; convert them or choose 'reference'")
    if drawing.backend == "gpu":
        _check_gpu(dtype, device, drawing.cutoffs)
    if drawing.threads < 1:
        raise ValueError(f"drawing.threads = {drawing.threads}: at least 1")


def _check_gpu(dtype: torch.dtype, device: torch.device, cutoffs: Cutoffs) -> None:
    if dtype != torch.float32:
        raise ValueError(f"drawing.backend = 'gpu' with {dtype} Gaussians: it draws float32; convert them or choose 'reference'")
    if lacking := gpu.lacks(device):
        raise ValueError(f"drawing.backend = 'gpu': {lacking}")
    if cutoffs.alpha_max >= 1 and cutoffs.transmittance_stop < 0:
        raise ValueError(f"drawing.cutoffs.alpha_max = {cutoffs.alpha_max} with transmittance_stop = {cutoffs.transmittance_stop}: 'gpu' divides by 1 - alpha; cap alpha below 1 or stop at 0")
