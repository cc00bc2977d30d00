"""The CPU back end: numba kernels over flat float32 arrays, one after the other, on one or several threads, with
gradients.

project -> count and fill tiles -> sort -> composite, and back: slots -> Gaussians. Threads share out Gaussians, then
tiles; no two write to the same place and every sum has a fixed order, so the result does not depend on their number.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from posegaussian.stages.splatting.cpu import composite, projection, projection_backward
from posegaussian.stages.splatting.cpu import tiles as cpu_tiles
from posegaussian.stages.splatting.cpu.composite import BLOCKS, PLACES
from posegaussian.stages.splatting.cpu.projection import BLOCK, CAMERA_GRADIENTS, REACHES, RECORD, SLOT, VIEW
from posegaussian.stages.splatting.cpu.simd import WIDTH
from posegaussian.stages.splatting.cpu.tiles import TILE_X, TILE_Y
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians, TooLarge

log = logging.getLogger(__name__)
ATTRIBUTES = ("mean", "rotation", "scale", "opacity", "color")
SIZES = (3, 9, 3, 1, 3)
"""float32 of each attribute of a Gaussian."""
CACHE = Path(projection.project.stats.cache_path)
"""Where numba keeps compiled kernels."""
CACHE_LINE = 64
"""Bytes."""
LARGEST_SIDE = 32767
"""px: boxes are kept in 16 bits."""
MOST_INTERSECTIONS = 2**32 - 1
"""Slots are numbered in 32 bits; at 64 bytes each nothing near that fits into memory."""


@dataclass(frozen=True, eq=False)
class CpuJob:
    """One camera's rendering without its Gaussians."""

    view: np.ndarray
    """[VIEW] float32, see cpu_projection."""
    cuts: np.ndarray
    """[3] float32: alpha_max, transmittance_stop, reach."""
    width: int
    height: int
    channels: int
    """3: colour; 4: and depth; 7: and normal."""
    threads: int

    @property
    def across(self) -> int:
        """Tiles in a row."""
        return -(-self.width // TILE_X)

    @property
    def tiles(self) -> int:
        """Tiles of the picture."""
        return self.across * -(-self.height // TILE_Y)


@dataclass(frozen=True, eq=False)
class CpuTileLists:
    """What is composited where."""

    records: np.ndarray  # [N, RECORD] flat, padded to a multiple of WIDTH
    bases: np.ndarray  # [N + 1] first slot of each Gaussian
    starts: np.ndarray  # [tiles + 1]
    order: np.ndarray  # [M] Gaussians by tile and depth
    slots: np.ndarray  # [M] slots by tile and depth; none without training
    masked: int


def job(camera: Camera, cutoffs: Cutoffs, channels: int, threads: int) -> CpuJob:
    """Camera and cut-offs as the kernels want them. Raises TooLarge."""
    for name, side in (("width", camera.width), ("height", camera.height)):
        if side > LARGEST_SIDE:
            raise TooLarge(
                f"camera.{name} = {side} px: the cpu back end draws up to {LARGEST_SIDE} px a side; render in parts, or"
                " with backend='reference'"
            )
    k, pose = (
        np.asarray(m.detach().cpu() if isinstance(m, torch.Tensor) else m, np.float64)
        for m in (camera.intrinsics, camera.world_to_camera)
    )
    fx, fy, cx, cy, w, h = k[0, 0], k[1, 1], k[0, 2], k[1, 2], camera.width, camera.height
    margin_x, margin_y = cutoffs.frustum_margin * 0.5 * w / fx, cutoffs.frustum_margin * 0.5 * h / fy
    reach = -math.log2(cutoffs.alpha_min)
    view = [
        *pose[:3, :3].ravel(),
        *pose[:3, 3],
        fx,
        k[0, 1],
        cx,
        fy,
        cy,
        -cx / fx - margin_x,
        (w - cx) / fx + margin_x,
        -cy / fy - margin_y,
        (h - cy) / fy + margin_y,
    ]
    view += [
        cutoffs.near,
        cutoffs.low_pass,
        cutoffs.variance_min,
        cutoffs.alpha_min,
        reach,
        w - 1,
        h - 1,
        float(cutoffs.compensation),
        cutoffs.compensation_min,
    ]
    assert len(view) == VIEW
    return CpuJob(
        np.array(view, np.float32),
        np.array([cutoffs.alpha_max, cutoffs.transmittance_stop, reach], np.float32),
        w,
        h,
        channels,
        threads,
    )


def share(threads: int, work: Callable[[int, int], Any], bounds: Iterable[int]) -> list[Any]:
    """Results of work(first, stop) of consecutive bounds, on `threads` threads; a kernel lets go of the interpreter."""
    edges = list(bounds)
    ranges = list(pairwise(edges))
    if threads == 1 or len(ranges) < 2:
        return [work(*r) for r in ranges]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda r: work(*r), ranges))


def _by_load(starts: np.ndarray, threads: int) -> list[int]:
    """Tiles at which to cut into ranges of about equal lists: one a thread would wait for the slowest."""
    parts = 1 if threads == 1 else 8 * threads
    cuts = np.searchsorted(starts, np.linspace(0, starts[-1], parts + 1)[1:-1])
    return sorted({0, *(int(c) for c in cuts), len(starts) - 1})


def _evenly(count: int, threads: int, multiple: int) -> list[int]:
    step = max(multiple, -(-count // (threads * multiple)) * multiple)
    return [*range(0, count, step), count]


def _padded(array: np.ndarray, size: int, whole: int) -> np.ndarray:
    """The rows from `whole` on, filled up with zeros to WIDTH rows, flat."""
    tail = np.zeros(WIDTH * size, np.float32)
    rest = array[whole * size :]
    tail[: len(rest)] = rest
    return tail


def _new(name: str, size: int, dtype: type) -> np.ndarray:
    """An array of any content that begins with a cache line, so that a record or a slot, which are as long as one, lies
    in one: else each would take two, of which one is fetched ahead."""
    line = CACHE_LINE // np.dtype(dtype).itemsize
    room: np.ndarray = np.empty(size + line, dtype)
    begin = -room.ctypes.data % CACHE_LINE // room.itemsize
    return room[begin : begin + size]


class _Scratch(threading.local):
    """Arrays that do not outlive a call, kept for the thread's next one: asking the system for fresh memory took a
    tenth of the time."""

    largest = 2**26
    """Bytes; larger arrays are not kept."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}

    def __call__(self, name: str, size: int, dtype: type) -> np.ndarray:
        """An array of any content; the one of this name that the thread was given before is used up."""
        kept = self.arrays.get(name)
        if kept is None or len(kept) < size:
            kept = _new(name, size + size // 8, dtype)
            if kept.nbytes <= self.largest:
                self.arrays[name] = kept
        return kept[:size]


scratch = _Scratch()


def project(
    arrays: list[np.ndarray], task: CpuJob, new: Callable[[str, int, type], np.ndarray] = _new
) -> tuple[np.ndarray, np.ndarray, int]:
    """(records [N, RECORD], reaches [N, REACHES] int32, masked), flat. arrays:
    flat contiguous float32 in the order of ATTRIBUTES."""
    n = len(arrays[3])
    whole = n // WIDTH * WIDTH
    records, reaches = (
        new("records", (whole + WIDTH) * RECORD, np.float32),
        scratch("reaches", (whole + WIDTH) * REACHES, np.float32),
    )
    masked = (
        sum(
            share(
                task.threads,
                lambda a, b: projection.project(*arrays, task.view, records, reaches, a, b, a),
                _evenly(whole, task.threads, WIDTH),
            )
        )
        if whole
        else 0
    )
    tail = [_padded(a, size, whole) for a, size in zip(arrays, SIZES, strict=True)]
    masked += projection.project(*tail, task.view, records, reaches, 0, WIDTH, whole)
    return records[: n * RECORD], reaches[: n * REACHES].view(np.int32), masked


def list_tiles(
    records: np.ndarray, reaches: np.ndarray, task: CpuJob, training: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(bases [N + 1], starts [tiles + 1], entries [M], owners [M]): unsorted lists, of slots for training, else of
    Gaussians, which have no owners. Raises TooLarge."""
    n, reach = len(records) // RECORD, float(task.cuts[2])
    counts, bases = np.zeros(task.tiles, np.int64), np.empty(n + 1, np.int64)
    total = cpu_tiles.count_tiles(records, reaches, task.across, reach, counts, bases)
    if total > MOST_INTERSECTIONS:
        raise TooLarge(
            f"{total} intersections of {n} Gaussians with tiles of {TILE_X}x{TILE_Y} px, at most {MOST_INTERSECTIONS}:"
            " render smaller pictures or drop Gaussians that cover all of them"
        )
    starts = np.zeros(task.tiles + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    entries, owners = scratch("entries", total, np.uint64), scratch("owners", total if training else 0, np.uint32)
    cpu_tiles.fill_tiles(records, reaches, task.across, reach, starts[:-1].copy(), entries, owners)
    return bases, starts, entries, owners


def sort_tiles(
    starts: np.ndarray,
    entries: np.ndarray,
    owners: np.ndarray,
    task: CpuJob,
    new: Callable[[str, int, type], np.ndarray] = _new,
) -> tuple[np.ndarray, np.ndarray]:
    """(order [M], slots [M], none without owners): Gaussians and slots by tile and depth. entries are used up."""
    order, slots, longest = (
        new("order", len(entries), np.uint32),
        new("slots", len(owners), np.uint32),
        int(np.diff(starts).max(initial=0)),
    )
    share(
        task.threads,
        lambda a, b: cpu_tiles.sort_tiles(starts, a, b, entries, np.empty(longest, np.uint64), owners, order, slots),
        _by_load(starts, task.threads),
    )
    return order, slots


def prepare(arrays: list[np.ndarray], task: CpuJob, training: bool) -> CpuTileLists:
    """Project, list and sort. Without training the lists last until the thread's next call. Raises TooLarge."""
    new = _new if training else scratch
    records, reaches, masked = project(arrays, task, new)
    bases, starts, entries, owners = list_tiles(records, reaches, task, training)
    return CpuTileLists(records, bases, starts, *sort_tiles(starts, entries, owners, task, new), masked)


def draw(lists: CpuTileLists, task: CpuJob, training: bool) -> tuple[np.ndarray, ...]:
    """(picture [h, w, channels], alpha [h, w], light, ends, blended):
    what the backward pass wants is empty without training."""
    picture, alpha = (
        np.zeros((task.height, task.width, task.channels), np.float32),
        np.zeros((task.height, task.width), np.float32),
    )
    light, ends = (_new(n, task.tiles * BLOCKS * WIDTH if training else 0, np.float32) for n in ("light", "ends"))
    blended = np.zeros(len(lists.order) if training else 0, np.uint64)
    kernel = composite.forward(task.channels, training)
    fixed = (lists.records, lists.records.view(np.int32), lists.order, lists.starts, PLACES, task.cuts)
    share(
        task.threads,
        lambda a, b: kernel(*fixed, a, b, task.across, task.width, task.height, picture, alpha, light, ends, blended),
        _by_load(lists.starts, task.threads),
    )
    return picture, alpha, light, ends, blended


def draw_backward(
    lists: CpuTileLists, task: CpuJob, saved: Sequence[np.ndarray], up_picture: np.ndarray, up_alpha: np.ndarray
) -> np.ndarray:
    """[M, SLOT] flat gradient slots, which last until the thread's next call, from what `draw` saved and the
    gradients of picture and alpha."""
    slots = scratch("gradients", len(lists.order) * SLOT, np.float32)
    kernel = composite.backward(task.channels)
    fixed = (lists.records, lists.order, lists.slots, lists.starts, PLACES, task.cuts)
    rest = (task.across, task.width, task.height, up_picture, up_alpha, *saved, slots)
    share(task.threads, lambda a, b: kernel(*fixed, a, b, *rest), _by_load(lists.starts, task.threads))
    return slots


def prepare_backward(
    arrays: list[np.ndarray], lists: CpuTileLists, task: CpuJob, slots: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Gradients of the attributes, flat, in the order of ATTRIBUTES, and of the camera [CAMERA_GRADIENTS] float64."""
    n = len(arrays[3])
    whole = n // WIDTH * WIDTH
    out = [np.empty((whole + WIDTH) * size, np.float32) for size in SIZES]
    kernel = projection_backward.project_backward

    def part(first: int, stop: int, source: int, given: list[np.ndarray]) -> tuple[np.ndarray, int]:
        d_camera = np.zeros(CAMERA_GRADIENTS)
        return d_camera, kernel(
            *given[:4], task.view, lists.bases, slots, task.channels, source, first, stop, *out, d_camera
        )

    # ranges of BLOCK, whatever the threads: the camera's sum is taken over the same parts in the same order
    parts = share(task.threads, lambda a, b: part(a, b, a, arrays), [*range(0, whole, BLOCK), whole]) if whole else []
    if whole < n:
        parts.append(part(whole, n, 0, [_padded(a, size, whole) for a, size in zip(arrays, SIZES, strict=True)]))
    if dropped := sum(p[1] for p in parts):
        log.warning(
            "the gradients of %d Gaussians are beyond float32 and were set to 0: their colours, scales or upstream"
            " gradients are too large",
            dropped,
        )
    camera = np.sum(np.array([np.zeros(CAMERA_GRADIENTS), *(p[0] for p in parts)]), axis=0)
    return [o[: n * size] for o, size in zip(out, SIZES, strict=True)], camera


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
        task: CpuJob,
    ) -> Any:
        arrays = [flat(t) for t in (mean, rotation, scale, opacity, color)]
        training = any(ctx.needs_input_grad)
        lists = prepare(arrays, task, training)
        picture, alpha, *saved = draw(lists, task, training)
        if training:
            ctx.saved = (arrays, lists, task, saved)
        ctx.kinds = (intrinsics.dtype, pose.dtype)
        ctx.mark_non_differentiable(masked := torch.tensor(lists.masked))
        return torch.from_numpy(picture), torch.from_numpy(alpha), masked

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, d_picture: torch.Tensor, d_alpha: torch.Tensor, _: Any) -> Any:
        arrays, lists, task, saved = ctx.saved
        up = [np.ascontiguousarray(d.numpy(), dtype=np.float32) for d in (d_picture, d_alpha)]
        slots = draw_backward(lists, task, saved, *up)
        gradients, camera = prepare_backward(arrays, lists, task, slots)
        shapes = ((-1, 3), (-1, 3, 3), (-1, 3), (-1,), (-1, 3))
        d_pose, d_intrinsics = np.zeros((4, 4)), np.zeros((3, 3))
        d_pose[:3, :3], d_pose[:3, 3] = camera[:9].reshape(3, 3), camera[9:12]
        d_intrinsics[0], d_intrinsics[1, 1:] = camera[12:15], camera[15:17]
        kinds = ctx.kinds
        return (
            *(torch.from_numpy(g.reshape(s)) for g, s in zip(gradients, shapes, strict=True)),
            torch.from_numpy(d_intrinsics).to(kinds[0]),
            torch.from_numpy(d_pose).to(kinds[1]),
            None,
        )


def flat(values: torch.Tensor) -> np.ndarray:
    """A tensor as one contiguous row of float32:
    kernels read by position, so a strided view must become one of its own."""
    return values.detach().contiguous().numpy().reshape(-1)


@cache
def announce(folder: Path) -> None:
    """Say, once a process and only where nothing is compiled yet, that the first picture takes longer."""
    if not any(folder.glob(f"{Path(str(projection.__file__)).stem}.project-*.nbc")):
        log.warning("compiling the renderer for this processor, once: some ten seconds; kept in %s", folder)


def render(
    gaussians: Gaussians, camera: Camera, cutoffs: Cutoffs, channels: int, threads: int
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """(picture [h, w, channels], alpha [h, w], masked) of one camera. Gaussians are float32 on the CPU."""
    announce(CACHE)
    task = job(camera, cutoffs, channels, threads)
    cameras = [
        m if isinstance(m, torch.Tensor) else torch.from_numpy(np.asarray(m, np.float64))
        for m in (camera.intrinsics, camera.world_to_camera)
    ]
    picture, alpha, masked = _Rasterize.apply(*(getattr(gaussians, name) for name in ATTRIBUTES), *cameras, task)
    return picture, alpha, int(masked)
