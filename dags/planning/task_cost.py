"""What one task is expected to take: work, bytes and memory, from its declarations and the shape of its partition."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.tasks import Task, worked_frames
from posegaussian.stages.contract.declaration import Resources, Stage
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.model.spec import ArraySpec


@dataclass(frozen=True)
class Load:
    """The size of one task, known before it runs."""

    work: int = 0
    """Frames x views or cameras x pixels: what seconds are in proportion to."""
    unit: str = ""
    """Name of what it is counted in, as the stage declares."""
    raw_bytes: int = 0
    """Bytes of its outputs before compression."""
    ram: int = 0
    """Projected peak of its process, bytes: its own and the libraries'."""
    vram: int = 0
    """Projected peak of device memory, bytes."""


def partition_shape(context: Context, path: str | None = None) -> dict[str, int]:
    """Dimensions of one partition: as the sequence's, but `frame` is the partition's length."""
    return {**context.shape(path), "frame": min(context.grid.length, context.grid.frames)}


RESERVED = 576 * 2**20
"""Bytes of a worker's process beside a task's own: interpreter, libraries, compiled kernels. Measured: 0.35 GB after
the imports, 0.55 GB once every stage ran in it (benchmarks.pipeline.memory)."""


def raw_bytes(context: Context, task: Task, frames: int) -> dict[str, int]:
    """{declared array: bytes before compression} of a task over so many frames."""
    shape = {**context.shape(task.path), "frame": frames} | ({"view": 1} if task.view is not None else {})
    specs = [w for w in stage_named(task.stage).writes_for(context.facts) if isinstance(w, ArraySpec)]
    return {w.name: math.prod(w.lengths(shape)) * np.dtype(w.dtype).itemsize for w in specs}


def load(context: Context, task: Task, frames: int | None = None) -> Load:
    """What one task is expected to take, from its declarations and the shape of its partition, or of one of `frames`
    frames."""
    stage = stage_named(task.stage)
    if frames is None:
        frames = len(worked_frames(context, task))
    needs = needs_of(context, stage, task.path, frames)
    return Load(
        work(context, task, frames),
        stage.unit.name,
        sum(raw_bytes(context, task, frames).values()),
        needs.ram,
        needs.vram,
    )


def work(context: Context, task: Task, frames: int) -> int:
    """Frames x views or cameras x pixels of a task over so many frames, in the unit of its stage; a sequence-wide one
    looks at a sample of frames."""
    stage, shape = stage_named(task.stage), context.shape(task.path)
    if task.path is not None:
        each, worked = shape["camera"], shape["camera_y"] * shape["camera_x"]
    else:
        each = 1 if task.view is not None else len(context.views_of(stage).sources)
        frames, worked = shape["sample"] if stage.sequence_wide else frames, shape["y"] * shape["x"]
    pixels = stage.unit.worked * worked + stage.unit.captured * shape["source_y"] * shape["source_x"]
    return round((frames + stage.unit.besides) * each * pixels)


def needs_of(context: Context, stage: Stage, path: str | None = None, frames: int | None = None) -> Resources:
    """What one task of a stage needs over a whole partition, or over one of `frames` frames; the memory is its whole
    process's."""
    shape = partition_shape(context, path) | ({} if frames is None else {"frame": frames})
    needs = stage.needs(shape, context.params(stage))
    return dataclasses.replace(needs, ram=needs.ram + RESERVED)
