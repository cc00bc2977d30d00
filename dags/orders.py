"""From a judged task to the order a worker gets, and the arrays that must exist before any worker starts."""

from __future__ import annotations

from typing import Any

from dags.context import Context
from dags.execute import Order, Reading
from dags.plan import Book, Plan, State
from dags.tasks import Task, inputs, path_frames
from stages.registry import STAGES
from stages.registry import stage as stage_named
from storage.receipts import ShardFile
from storage.rig import CameraPath
from storage.spec import ArraySpec


def make_order(context: Context, book: Book, task: Task, parts: dict[str, Any], threads: int) -> Order:
    """The order of one task whose inputs are all there."""
    stage = stage_named(task.stage)
    frames = context.grid.bounds(task.partition) if task.partition is not None else range(0)
    own = slice(frames.start, frames.stop)
    readings = {}
    for i in inputs(context, task):
        files: dict[int | None, tuple[ShardFile, ...]] = dict.fromkeys(i.views, ())
        for product in i.products:
            output = book.output(product, task)
            assert output is not None, f"{task.label()} was ordered before {product} exists"
            files[product.view] = (*files[product.view], *output.files)
        readings[i.read.array] = Reading(i.name, i.spec.dims, i.span, files)
    pictures = context.capture.pictures
    return Order(
        root=context.sequence.root,
        stage=stage.name,
        params=context.params(stage),
        partition=task.partition,
        view=task.view,
        path_name=task.path,
        frames=frames,
        source_frames=context.source_frames[own],
        time=context.time[own],
        valid=context.valid[own],
        views=context.views,
        rig=context.rig,
        captured_to_calibrated=context.captured_to_calibrated,
        path=_path(context, task),
        facts=context.facts,
        joint_set=context.joint_set,
        readings=readings,
        parts=parts,
        survey_sources=pictures[task.view].digest(context.capture.numbers) if stage.sequence_wide and task.view is not None else None,
        threads=threads,
        gpu=stage.needs(partition_shape(context, task.path), context.params(stage)).gpu > 0,
    )


def _path(context: Context, task: Task) -> CameraPath | None:
    """The camera path over the frames the task sees."""
    if task.path is None:
        return None
    span = path_frames(context, task)
    return context.paths[task.path].slice(slice(span.start, span.stop))


def partition_shape(context: Context, path: str | None = None) -> dict[str, int]:
    """Dimensions of one partition: as the sequence's, but `frame` is the partition's length."""
    return {**context.shape(path), "frame": min(context.grid.length, context.grid.frames)}


def prepare(plan: Plan) -> None:
    """Make, grow or replace the arrays of every stage that has something to do, and write the cameras beside the pictures."""
    context = plan.context
    for stage in STAGES:
        verdicts = [v for v in plan.verdicts.values() if v.task.stage == stage.name]
        if all(v.state is State.FRESH for v in verdicts):
            continue
        for spec in stage.writes_for(context.facts):
            if not isinstance(spec, ArraySpec):
                continue
            for path in context.paths if "path" in stage.over else [None]:
                context.sequence.ensure_array(spec, context.shape(path), path or "")
    sequence = context.sequence
    sequence.put_rig("frames", context.rig)
    sequence.put("frames/time", context.time, ("frame",), "s", "Source frame number over frame rate.")
    sequence.put("frames/valid", context.valid, ("frame", "view"), "1", "Whether the view has a picture of the frame.")
    sequence.put("frames/number", context.source_frames, ("frame",), "1", "Source frame number.")
    for name, cameras in context.paths.items():
        prefix = f"rendering/{name}"
        sequence.put(f"{prefix}/intrinsics", cameras.intrinsics, ("frame", "camera", "row", "column"), "px", "Our pixel centres.")
        sequence.put(f"{prefix}/world_to_camera", cameras.world_to_camera, ("frame", "camera", "row", "column"), "m", "Rigid motion, OpenCV axes.")
        sequence.put(f"{prefix}/served", cameras.served, ("frame", "camera"), "1", "Whether the camera serves the frame.")
