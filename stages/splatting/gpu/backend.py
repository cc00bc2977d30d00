"""The GPU back end: Triton kernels of our own, and torch's sorts on the device.

project -> sort by depth -> list tiles -> composite, and back: slots -> sums of each Gaussian -> projection, cameras
included. No fraction is added by atomics: an intersection has its slot and slots are summed in one order, so that two
runs give the same bits. A picture starts some twenty kernels, and waits for the device once, to learn how many
intersections there are: starting one takes longer than most of them work.

It is the only engine. gsplat 1.5 computes something else: its constants are compiled in (alpha cap 0.999, stop at
1e-4), its backward pass adds by atomics in whatever order, intrinsics get no gradient, and what is not finite is
neither masked nor counted. Beside this one it would make `gpu` two back ends of different numbers under one name.
benchmarks/gpu/renderer.py times it where it is installed.

Without a GPU the kernels run on the CPU in Triton's interpreter, slowly, where TRITON_INTERPRET=1 is set before Triton
is imported: this is for tests.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians

if TYPE_CHECKING:
    from posegaussian.stages.splatting.gpu.tiles import DepthOrder, GpuTileLists

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
    intersections, but a picture and its gradients take a device 1.6 to 2.4 times as long (an H100, four Gaussians at
    once)."""
    chunk: int = 4
    """Gaussians taken at once, a power of two. Of a picture and its gradients an H100 works 0.77, 0.95 and 1.82 ms at
    512, 1024 and 2048 px with 4, 0.79, 0.89 and 1.67 with 2, 0.95, 1.35 and 2.77 with 8."""
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


def draw(rows: torch.Tensor, lists: GpuTileLists, task: GpuJob, training: bool) -> Drawn:
    """Composite rows [N, 16] by their lists."""
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


def slot_sums(
    rows: torch.Tensor,
    lists: GpuTileLists,
    bases: torch.Tensor,
    task: GpuJob,
    light: torch.Tensor,
    ends: torch.Tensor,
    up_picture: torch.Tensor,
    up_alpha: torch.Tensor,
) -> torch.Tensor:
    """[N, SLOT] sums of each Gaussian's gradient slots, nearest first as `bases` has them, from what compositing left
    and the gradients of picture and alpha."""
    from posegaussian.stages.splatting.gpu.composite import SLOT, composite_backward

    w, h, cuts, shape = task.camera.width, task.camera.height, task.cutoffs, task.shape
    slots = rows.new_zeros((len(lists.slots), SLOT))
    with torch.cuda.device_of(rows):
        composite_backward[(task.tiles,)](
            rows,
            lists.ids,
            lists.slots,
            lists.starts,
            light,
            ends,
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
    return torch.segment_reduce(slots, "sum", offsets=bases, axis=0, unsafe=True)


class Projected(NamedTuple):
    """N Gaussians as compositing reads them; see `posegaussian.stages.splatting.gpu.projection.project`."""

    rows: torch.Tensor  # [N, ROW]
    boxes: torch.Tensor  # [N, 4] int32
    """Tiles x0, y0, x1, y1, half open."""
    depths: torch.Tensor  # [N] int32
    """Whole numbers that sort as metres do, the largest where no tile is reached."""
    reached: torch.Tensor  # [N] int32
    """Tiles."""
    tallies: torch.Tensor  # [2] int64
    """Tiles that are reached in all, and Gaussians left out because they or their projections are not finite."""


def project(attributes: Sequence[torch.Tensor], view: torch.Tensor, task: GpuJob) -> Projected:
    """Project Gaussians, given by contiguous float32 `ATTRIBUTES`."""
    from posegaussian.stages.splatting.gpu import projection

    number, opacity = len(attributes[0]), attributes[3]
    rows, tallies = opacity.new_empty((number, projection.ROW)), opacity.new_zeros(2, dtype=torch.int64)
    boxes, depths, reached = (opacity.new_empty(s, dtype=torch.int32) for s in ((number, 4), (number,), (number,)))
    found = Projected(rows, boxes, depths, reached, tallies)
    if number:
        with torch.cuda.device_of(opacity):
            projection.project[(-(-number // projection.BLOCK),)](
                *attributes,
                view,
                *found,
                number,
                TILE=task.shape.tile,
                COMPENSATED=task.cutoffs.compensation,
                BLOCK=projection.BLOCK,
                enable_fp_fusion=False,
            )
    return found


def project_backward(
    attributes: Sequence[torch.Tensor],
    view: torch.Tensor,
    order: DepthOrder,
    sums: torch.Tensor,
    task: GpuJob,
    camera: bool,
) -> tuple[list[torch.Tensor], torch.Tensor | None]:
    """(gradients of `ATTRIBUTES`, gradients [CAMERA_GRADIENTS] float64 of the camera where asked for), from the sums of
    slots; a Gaussian whose gradient is beyond float32 gets none and adds none to the camera's, and is counted aloud."""
    from posegaussian.stages.splatting.gpu import projection_backward as kernels

    gradients = [torch.empty_like(values) for values in attributes]
    number = len(order.ids)
    shares = sums.new_empty((number if camera else 0, kernels.CAMERA_GRADIENTS))
    dropped = torch.zeros(1, dtype=torch.int32, device=sums.device)
    if number:
        with torch.cuda.device_of(sums):
            kernels.project_backward[(-(-number // kernels.BLOCK),)](
                *attributes[:4],
                view,
                *order,
                sums,
                *gradients,
                shares,
                dropped,
                number,
                CHANNELS=task.channels,
                COMPENSATED=task.cutoffs.compensation,
                CAMERA=camera,
                BLOCK=kernels.BLOCK,
                enable_fp_fusion=False,
            )
    if beyond := int(dropped):
        log.warning(
            "the gradients of %d Gaussians are beyond float32 and were set to 0: their colours, scales or upstream"
            " gradients are too large",
            beyond,
        )
    return gradients, shares.sum(dim=0, dtype=torch.float64) if camera else None


def camera_gradients(found: torch.Tensor, intrinsics: torch.Tensor, pose: torch.Tensor) -> list[torch.Tensor]:
    """Of both matrices, as they were given, from the numbers in the order of `CAMERA_GRADIENTS`; a sum beyond the
    matrix's numbers is 0."""
    k, to_camera = found.new_zeros((3, 3)), found.new_zeros((4, 4))
    k.view(-1)[[0, 1, 2, 4, 5]] = found[12:]
    to_camera[:3, :3], to_camera[:3, 3] = found[:9].view(3, 3), found[9:12]
    return [
        torch.nan_to_num(g.to(like.device, like.dtype), nan=0.0, posinf=0.0, neginf=0.0)
        for g, like in ((k, intrinsics), (to_camera, pose))
    ]


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
        from posegaussian.stages.splatting.gpu.projection import view_of
        from posegaussian.stages.splatting.gpu.tiles import by_depth, list_tiles

        training = any(ctx.needs_input_grad)
        attributes = [t.detach().contiguous() for t in (mean, rotation, scale, opacity, color)]
        view = view_of(replace(task.camera, intrinsics=intrinsics, world_to_camera=pose), task.cutoffs, mean.device)
        projected = project(attributes, view, task)
        order = by_depth(projected.depths, projected.reached)  # before the device is waited for
        total, masked = projected.tallies.tolist()
        lists = list_tiles(projected.boxes, order, total, task.camera, task.shape.tile)
        drawn = draw(projected.rows, lists, task, training)
        if training:
            # not the pictures: what is returned holds ctx, and both would live until the collector came by
            kept = (*attributes, view, projected.rows, *order, *lists, drawn.light, drawn.ends)
            ctx.save_for_backward(*kept, intrinsics, pose)
            ctx.task = task
        ctx.mark_non_differentiable(left_out := torch.tensor(masked))
        return drawn.picture, drawn.alpha, left_out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, d_picture: torch.Tensor, d_alpha: torch.Tensor, _: Any) -> Any:
        from posegaussian.stages.splatting.gpu.tiles import DepthOrder, GpuTileLists

        kept = ctx.saved_tensors
        attributes, (view, rows), order, lists = kept[:5], kept[5:7], DepthOrder(*kept[7:9]), GpuTileLists(*kept[9:12])
        light, ends, intrinsics, pose = kept[12:]
        sums = slot_sums(rows, lists, order.bases, ctx.task, light, ends, d_picture, d_alpha)
        gradients, found = project_backward(attributes, view, order, sums, ctx.task, any(ctx.needs_input_grad[5:7]))
        cameras = (None, None) if found is None else camera_gradients(found, intrinsics, pose)
        return (*gradients, *cameras, None)


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
