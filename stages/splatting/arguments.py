"""What `rasterize` refuses before anything is drawn: every sentence names the argument, its value and what to do."""

from __future__ import annotations

import math
from typing import get_args

import torch

from posegaussian.stages.splatting.definition.scene import Backend, Camera, Cutoffs, Drawing, Gaussians
from posegaussian.stages.splatting.gpu import backend

EXTRAS = ("depth", "normal")
"""Pictures beside colour and alpha."""
SHAPES = {"mean": (3,), "rotation": (3, 3), "scale": (3,), "opacity": (), "color": (3,)}
"""Of one Gaussian."""
ROUNDING = 1e-6
"""By which a matrix's constant entries may be off."""


def check(gaussians: Gaussians, cameras: object, extras: object, drawing: Drawing) -> None:
    """Raise ValueError for what no back end can draw."""
    _check_cameras(cameras)
    if isinstance(extras, str) or any(e not in EXTRAS for e in extras):  # type: ignore[attr-defined]
        raise ValueError(
            f"extras = {extras!r}: pass a tuple of any of {', '.join(map(repr, EXTRAS))};"
            " colour and alpha are always drawn"
        )
    _check_gaussians(gaussians)
    _check_drawing(drawing, gaussians)


def _check_cameras(cameras: object) -> None:
    if not isinstance(cameras, (list, tuple)) or not cameras or not all(isinstance(c, Camera) for c in cameras):
        given = f"one of {cameras.width} x {cameras.height} px" if isinstance(cameras, Camera) else repr(cameras)
        raise ValueError(f"cameras = {given}: pass a list of one or more cameras, also for a single one")
    for camera in cameras:
        for name, side in (("width", camera.width), ("height", camera.height)):
            if not hasattr(side, "__index__") or side < 1:
                raise ValueError(
                    f"camera.{name} = {side!r} px: a picture has a whole number of pixels, at least 1; round it"
                )
        for name, shape in (("intrinsics", (3, 3)), ("world_to_camera", (4, 4))):
            _check_matrix(f"camera.{name}", getattr(camera, name), shape)
    sizes = sorted({(c.width, c.height) for c in cameras})
    if len(sizes) > 1:
        raise ValueError(
            f"cameras of {len(sizes)} sizes, {sizes[0]} and {sizes[1]} px: their pictures make no array;"
            " call once a size"
        )


def _check_matrix(name: str, matrix: object, shape: tuple[int, int]) -> None:
    if not hasattr(matrix, "shape") or tuple(matrix.shape) != shape:
        given = f"has shape {tuple(matrix.shape)}" if hasattr(matrix, "shape") else f"= {matrix!r}"
        raise ValueError(f"{name} {given}: an array or tensor of shape {shape} is needed")
    # plain numbers: sixteen of them cost a tenth of what arrays cost
    values: list[list[float]] = (matrix.detach().cpu() if isinstance(matrix, torch.Tensor) else matrix).tolist()  # type: ignore[attr-defined]
    if not all(math.isfinite(v) for row in values for v in row):
        raise ValueError(
            f"{name} holds numbers that are not finite: {values}; nothing can be drawn, mend the calibration"
        )
    last = [0.0] * (shape[0] - 1) + [1.0]
    if any(abs(v - w) > ROUNDING for v, w in zip(values[-1], last, strict=True)):
        raise ValueError(f"{name} has the last row {values[-1]}: {last} is needed; is it transposed?")
    if shape[0] == 3 and (abs(values[1][0]) > ROUNDING * abs(values[0][0]) or min(values[0][0], values[1][1]) <= 0):
        raise ValueError(f"{name} = {values}: positive focal lengths on the diagonal and 0 below it are needed")


def _check_gaussians(gaussians: Gaussians) -> None:
    for name in SHAPES:
        if not isinstance(getattr(gaussians, name, None), torch.Tensor):
            raise ValueError(
                f"gaussians.{name} is a {type(getattr(gaussians, name, None)).__name__}: pass Gaussians of tensors,"
                " torch.as_tensor makes one of an array"
            )
    n, dtype, device = gaussians.mean.shape[:1], gaussians.mean.dtype, gaussians.mean.device
    for name, shape in SHAPES.items():
        values = getattr(gaussians, name)
        if tuple(values.shape) != (*n, *shape) or not n:
            raise ValueError(
                f"gaussians.{name} has shape {tuple(values.shape)}: {(*(n or ('N',)), *shape)} is needed beside means"
                f" of shape {tuple(gaussians.mean.shape)}; reshape it"
            )
        if (values.dtype, values.device) != (dtype, device):
            raise ValueError(
                f"gaussians.{name} is {values.dtype} on {values.device},"
                f" gaussians.mean is {dtype} on {device}: convert one of them"
            )
    if dtype not in (torch.float32, torch.float64):
        raise ValueError(f"gaussians.mean is {dtype}: convert the Gaussians to float32 or float64")


def _check_drawing(drawing: Drawing, gaussians: Gaussians) -> None:
    cutoffs = getattr(drawing, "cutoffs", None)
    if not isinstance(cutoffs, Cutoffs):
        raise ValueError(f"drawing = {drawing!r}: pass Drawing(cutoffs=Cutoffs(...), backend=..., threads=...)")
    if drawing.backend not in get_args(Backend):
        raise ValueError(f"drawing.backend = {drawing.backend!r}: choose from {', '.join(get_args(Backend))}")
    dtype, device = gaussians.mean.dtype, gaussians.mean.device
    if drawing.backend == "cpu" and (dtype, device.type) != (torch.float32, "cpu"):
        raise ValueError(
            f"drawing.backend = 'cpu' with {dtype} Gaussians on {device}: it draws float32 on the CPU; convert them or"
            " choose 'reference'"
        )
    if drawing.backend == "gpu":
        _check_gpu(dtype, device, cutoffs)
    if not hasattr(drawing.threads, "__index__") or drawing.threads < 1:
        raise ValueError(
            f"drawing.threads = {drawing.threads!r}: a whole number of at least 1 is needed; 1 draws without threads"
        )
    for name, low, high in _BOUNDS:
        value = getattr(cutoffs, name)
        if not (math.isfinite(value) and low <= value <= high):
            raise ValueError(
                f"drawing.cutoffs.{name} = {value!r}: choose a value in {low:g}..{high:g}, or leave it at"
                f" {getattr(Cutoffs(), name):g}"
            )
    if not 0 < cutoffs.alpha_min <= cutoffs.alpha_max:
        raise ValueError(
            f"drawing.cutoffs.alpha_min = {cutoffs.alpha_min!r}: choose a value above 0 and up to alpha_max ="
            f" {cutoffs.alpha_max:g}; 1e-9 leaves next to nothing out"
        )


def _check_gpu(dtype: torch.dtype, device: torch.device, cutoffs: Cutoffs) -> None:
    if dtype != torch.float32:
        raise ValueError(
            f"drawing.backend = 'gpu' with {dtype} Gaussians: it draws float32; convert them or choose 'reference'"
        )
    if lacking := backend.lacks(device):
        raise ValueError(f"drawing.backend = 'gpu': {lacking}")
    if cutoffs.alpha_max >= 1 and cutoffs.transmittance_stop < 0:
        raise ValueError(
            f"drawing.cutoffs.alpha_max = {cutoffs.alpha_max} with transmittance_stop = {cutoffs.transmittance_stop}:"
            " 'gpu' divides by 1 - alpha; cap alpha below 1 or stop at 0"
        )


_BOUNDS = (
    ("near", 0.0, math.inf),
    ("frustum_margin", 0.0, math.inf),
    ("low_pass", 0.0, math.inf),
    ("variance_min", 0.0, math.inf),
    ("compensation_min", 0.0, 1.0),
    ("alpha_min", 0.0, 1.0),
    ("alpha_max", 0.0, 1.0),
    ("transmittance_stop", -math.inf, 1.0),
)
"""(cut-off, least, largest value)."""
