"""The GPU back end: projection and tile lists by torch on the device, compositing by Triton kernels of our own.

project (projection.py) -> list tiles and sort -> composite, and back: slots -> Gaussians -> autograd through the
projection, cameras included. Nothing is added by atomics: an intersection has its slot and slots are summed in one
order, so that two runs give the same bits.

It is the only engine. gsplat 1.5 computes something else: its constants are compiled in (alpha cap 0.999, stop at
1e-4), its backward pass adds by atomics in whatever order, intrinsics get no gradient, and what is not finite is
neither masked nor counted. Beside this one it would make `gpu` two back ends of different numbers under one name.
benchmarks/gpu/renderer.py times it where it is installed.

Without a GPU the kernels run on the CPU in Triton's interpreter, slowly, where TRITON_INTERPRET=1 is set before Triton
is
imported: this is for tests. Triton 3.2 and 3.9 compile them for a GPU; they have not been run on one yet.
"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch

from posegaussian.stages.splatting.definition.projection import project
from posegaussian.stages.splatting.definition.reference import ByDepth, sorted_by_depth
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from posegaussian.stages.splatting.gpu.tiles import GpuTileLists, list_tiles

log = logging.getLogger(__name__)
ATTRIBUTES = ("mean", "rotation", "scale", "opacity", "color")
OLDEST = (3, 2)
"""Version of Triton that came with torch 2.6."""
INSTALL = "install the extra: pip install 'posegaussian[gpu]' (CUDA builds of torch for Linux bring Triton along)"


@dataclass(frozen=True)
class Shape:
    """How the kernels cut their work: it changes the time, and gradients by rounding."""

    tile: int = 8
    """Side of a tile, px, a power of two. With 16 the person of benchmarks/renderer/workloads.py has 0.6 of the
    intersections, but each takes 4.7 times the instructions in the backward pass and 3.8 times in the forward one
    (counted in sm_90 code)."""
    chunk: int = 8
    """Gaussians taken at once, a power of two. With 16 registers spill."""
    warps: int = 1
    """Of one program: sums over a tile's pixels need no barrier then."""


SHAPE = Shape()


@dataclass(frozen=True, eq=False)
class GpuJob:
    """One camera's rendering without its Gaussians."""

    camera: Camera
    cutoffs: Cutoffs
    channels: int
    """3: colour; 4: and depth; 7: and normal."""
    shape: Shape

    @property
    def across(self) -> int:
        """Tiles in a row."""
        return -(-self.camera.width // self.shape.tile)

    @property
    def tiles(self) -> int:
        """Tiles of the picture."""
        return self.across * -(-self.camera.height // self.shape.tile)


class Drawn(NamedTuple):
    """What compositing leaves."""

    picture: torch.Tensor  # [h, w, channels]
    alpha: torch.Tensor  # [h, w]
    light: torch.Tensor  # [h, w]
    """Transmittance behind the last Gaussian that is seen; one value alone without training."""
    ends: torch.Tensor  # [h, w] int32
    """One past that Gaussian's place in the lists, 0 where none is; one value alone without training."""


def interpreted() -> bool:
    """Whether Triton's kernels run in its interpreter, on the CPU."""
    return os.environ.get("TRITON_INTERPRET", "").lower() in ("1", "true", "on", "yes", "y")


@cache
def triton_version() -> str | None:
    """None where it does not import."""
    try:
        import triton
    except ImportError:
        return None
    return str(triton.__version__)


def lacks(device: torch.device) -> str | None:
    """What keeps the back end from drawing Gaussians on a device,
    as a sentence with what to do about it; None: nothing."""
    version = triton_version()
    if version is None:
        return f"Triton is not installed: {INSTALL}, or choose another back end"
    if tuple(int(n) for n in version.split(".")[:2]) < OLDEST:
        return (
            f"Triton {version} is too old, {'.'.join(map(str, OLDEST))} is needed:"
            f" {INSTALL}, or choose another back end"
        )
    if device.type == "cuda" or (device.type == "cpu" and interpreted()):
        return None
    if torch.cuda.is_available():
        return f"the Gaussians are on {device}: move them to 'cuda', or choose another back end"
    return (
        f"the Gaussians are on {device} and torch {torch.__version__} finds no CUDA device: choose 'cpu', or run where"
        " there is one, with a CUDA build of torch"
    )


def padded(features: torch.Tensor) -> torch.Tensor:
    """[K, 16] rows as the kernels read them, of features [K, 14]."""
    return torch.nn.functional.pad(features.detach(), (0, 2))


def draw(rows: torch.Tensor, lists: GpuTileLists, task: GpuJob, training: bool) -> Drawn:
    """Composite rows [K, 16] by their lists."""
    from posegaussian.stages.splatting.gpu.composite import composite

    w, h, cuts, shape = task.camera.width, task.camera.height, task.cutoffs, task.shape
    out = Drawn(
        rows.new_empty((h, w, task.channels)),
        rows.new_empty((h, w)),
        *(rows.new_empty((h, w) if training else (1,), dtype=t) for t in (torch.float32, torch.int32)),
    )
    with torch.cuda.device_of(rows):
        composite[(task.tiles,)](
            rows,
            lists.ids,
            lists.starts,
            *out,
            *(float(c) for c in (cuts.alpha_min, cuts.alpha_max, cuts.transmittance_stop)),
            task.across,
            w,
            h,
            CHANNELS=task.channels,
            TILE=shape.tile,
            CHUNK=shape.chunk,
            TRAINING=training,
            num_warps=shape.warps,
            enable_fp_fusion=True,
        )
    return out


def draw_backward(
    rows: torch.Tensor,
    lists: GpuTileLists,
    task: GpuJob,
    drawn: Drawn,
    up_picture: torch.Tensor,
    up_alpha: torch.Tensor,
) -> torch.Tensor:
    """[K, 14] gradients of the features, from those of picture and alpha."""
    from posegaussian.stages.splatting.gpu.composite import SLOT, composite_backward

    w, h, cuts, shape = task.camera.width, task.camera.height, task.cutoffs, task.shape
    slots = rows.new_zeros((len(lists.slots), SLOT))
    with torch.cuda.device_of(rows):
        composite_backward[(task.tiles,)](
            rows,
            lists.ids,
            lists.slots,
            lists.starts,
            drawn.light,
            drawn.ends,
            up_picture.contiguous(),
            up_alpha.contiguous(),
            slots,
            float(cuts.alpha_min),
            float(cuts.alpha_max),
            task.across,
            w,
            h,
            CHANNELS=task.channels,
            TILE=shape.tile,
            CHUNK=shape.chunk,
            num_warps=shape.warps,
            enable_fp_fusion=True,
        )
    return from_moments(rows, torch.segment_reduce(slots, "sum", offsets=lists.bases, axis=0, unsafe=True))


def from_moments(rows: torch.Tensor, sums: torch.Tensor) -> torch.Tensor:
    """[K, 14] gradients of the features, from each Gaussian's sum of slots [K, 16].

    With m = alpha dL/dalpha, (p, q) = W d and the sums of m, m p, ..., m q^2: dL/dcentre = W^T (m p, m q), dL/dopacity
    = m / o, dL/dW = -(m p, m q) d^T = -[[m p^2, m p q], [m p q, m q^2]] W^-T.
    """
    p0, p1, q0, q1, opacity = rows[:, 2:7].unbind(1)
    m, mp, mq, mpp, mpq, mqq = sums[:, :6].unbind(1)
    det = p0 * q1 - p1 * q0
    shape = [p1 * mpq - q1 * mpp, q0 * mpp - p0 * mpq, p1 * mqq - q1 * mpq, q0 * mpq - p0 * mqq]
    moved = [p0 * mp + q0 * mq, p1 * mp + q1 * mq, *(s / det for s in shape), m / opacity]
    return torch.cat([torch.stack(moved, dim=1), sums[:, 6:13]], dim=1)


def project_backward(leaves: list[torch.Tensor], kept: ByDepth, up: torch.Tensor) -> list[torch.Tensor]:
    """Gradients of the leaves, from those of the features [K, 14]; a Gaussian whose gradient is beyond float32 gets
    none and adds none to the camera's."""

    def through(rows: torch.Tensor) -> list[torch.Tensor]:
        given = torch.where(rows[:, None], up, 0.0)
        return list(
            torch.autograd.grad(
                kept.features, leaves, given, retain_graph=True, allow_unused=True, materialize_grads=True
            )
        )

    sound = torch.isfinite(up).all(dim=1)
    found = through(sound)
    finite = torch.stack([torch.isfinite(g[:, None]).flatten(1).all(dim=1) for g in found[:5]]).all(dim=0)  # [N]
    cameras = [torch.isfinite(g).all().to(up.device) for g in found[5:]]
    if bool(torch.stack([sound.all(), finite.all(), *cameras]).all()):
        return found
    sound &= finite[kept.ids]
    log.warning(
        "the gradients of %d Gaussians are beyond float32 and were set to 0: their colours, scales or upstream"
        " gradients are too large",
        int((~sound).sum()),
    )
    return [torch.nan_to_num(g, nan=0.0, posinf=0.0, neginf=0.0) for g in through(sound)]


class _Rasterize(torch.autograd.Function):
    """One camera, differentiable in the Gaussians, the intrinsics and the pose."""

    @staticmethod
    def forward(
        ctx: Any,
        mean: torch.Tensor,
        rotation: torch.Tensor,
        scale: torch.Tensor,
        opacity: torch.Tensor,
        color: torch.Tensor,
        intrinsics: torch.Tensor,
        pose: torch.Tensor,
        task: GpuJob,
    ) -> Any:
        training = any(ctx.needs_input_grad)
        leaves = [
            t.detach().requires_grad_(training) for t in (mean, rotation, scale, opacity, color, intrinsics, pose)
        ]
        with torch.set_grad_enabled(training):
            projected = project(
                Gaussians(*leaves[:5]),
                Camera(leaves[5], leaves[6], task.camera.width, task.camera.height),
                task.cutoffs,
            )
            kept = sorted_by_depth(projected, task.camera, task.shape.tile)
        rows, lists = padded(kept.features), list_tiles(kept.boxes, task.camera, task.shape.tile)
        drawn = draw(rows, lists, task, training)
        if training:
            ctx.saved = (leaves, kept, rows, lists, task, drawn)
        ctx.mark_non_differentiable(masked := torch.tensor(projected.masked))
        return drawn.picture, drawn.alpha, masked

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, d_picture: torch.Tensor, d_alpha: torch.Tensor, _: Any) -> Any:
        leaves, kept, rows, lists, task, drawn = ctx.saved
        return (*project_backward(leaves, kept, draw_backward(rows, lists, task, drawn, d_picture, d_alpha)), None)


def render(
    gaussians: Gaussians, camera: Camera, cutoffs: Cutoffs, channels: int
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """(picture [h, w, channels], alpha [h, w], masked) of one camera. Gaussians are float32, on a device that the
    back end does not lack."""
    cameras = [
        m if isinstance(m, torch.Tensor) else torch.from_numpy(np.asarray(m, np.float64))
        for m in (camera.intrinsics, camera.world_to_camera)
    ]
    picture, alpha, masked = _Rasterize.apply(
        *(getattr(gaussians, name) for name in ATTRIBUTES), *cameras, GpuJob(camera, cutoffs, channels, SHAPE)
    )
    return picture, alpha, int(masked)
