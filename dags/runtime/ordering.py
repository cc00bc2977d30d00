"""From a judged task to the order a worker gets, and the arrays that must exist before any worker starts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.fingerprint import assets
from posegaussian.dags.planning.plan import Plan, State, pictures_digest
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.task_cost import load, needs_of
from posegaussian.dags.planning.tasks import Task, inputs, path_frames, producer, source_spans, worked_frames
from posegaussian.dags.runtime.work_order import ArrayReading, Promise, WorkOrder
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.contract.io import TaskScope
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.array_metadata import ForeignArray, read_metadata
from posegaussian.storage.archive.receipts import ReceiptKey, ShardFile
from posegaussian.storage.model.cameras import INTRINSICS_AXES, POSE_AXES, CameraPath
from posegaussian.storage.model.spec import ArraySpec, array_digest, digest


def make_order(context: Context, book: Book, task: Task, parts: dict[str, Any], threads: int) -> WorkOrder:
    """The order of one task whose inputs are all there."""
    stage, scope = stage_named(task.stage), scope_of(context, task)
    readings, promises = {}, []
    for i in inputs(context, task):
        files: dict[int | None, tuple[ShardFile, ...]] = dict.fromkeys(i.views, ())
        for product in i.products:
            output = book.output(product, task)
            assert output is not None, f"{task.label()} was ordered before {product} exists"
            assert not output.dropped, f"{task.label()} was ordered before {product} was made again"
            files[product.view] = (*files[product.view], *output.files)
            maker = producer(product, task)
            promises.append(
                Promise(
                    ReceiptKey(maker.stage, maker.partition, maker.view, maker.path),
                    product.array,
                    product.view,
                    output.digest,
                )
            )
        readings[i.read.array] = ArrayReading(i.name, i.spec.dims, i.span, files)
    spans = source_spans(context, task)
    every = [scope.partition, *(r.span for r in readings.values() if len(r.span)), *spans.values()]
    first, last = min(s.start for s in every), max(s.stop for s in every)
    return WorkOrder(
        root=context.sequence.root,
        stage=stage.name,
        params=context.params(stage),
        partition=task.partition,
        path_name=task.path,
        scope=scope,
        late=context.late,
        masked=context.masked,
        path=_path_seen(context, task),
        path_text=context.paths[task.path].text if task.path is not None else None,
        readings=readings,
        shape=context.shape(task.path),
        parts=parts,
        source_spans=spans,
        footage=(first, context.source_frames[first:last], context.valid[first:last]),
        assets=assets(context, stage),
        pictures=pictures_digest(context, task) if stage.sequence_wide else None,
        threads=threads,
        gpu=needs_of(context, stage, task.path).gpu,
        load=load(context, task),
        promises=tuple(promises),
        seen=old.facts.get("token") if (old := book.receipts.get(task)) else None,
    )


def scope_of(context: Context, task: Task) -> TaskScope:
    """What a task is about."""
    frames = worked_frames(context, task)
    own = slice(frames.start, frames.stop)
    return TaskScope(
        partition=frames,
        source_frames=context.source_frames[own],
        time=context.time[own],
        valid=context.valid[own],
        views=context.views_of(stage_named(task.stage)),
        view=task.view,
        rig=context.rig_of(stage_named(task.stage)),
        source_rig=context.source_rig if stage_named(task.stage).trust is None else context.capture.rig,
        captured_to_calibrated=context.captured_to_calibrated,
        path=None if task.path is None else context.paths[task.path].slice(own),
        facts=context.facts,
        joint_set=context.joint_set,
        rate=float(context.capture.frame_rate),
        settings={name: getattr(context.settings, name) for name in stage_named(task.stage).sees},
    )


def _path_seen(context: Context, task: Task) -> tuple[int, CameraPath] | None:
    """(first frame index, camera path from there on) of all frames of which the task may see its path."""
    if task.path is None:
        return None
    span = path_frames(context, task)
    return span.start, context.paths[task.path].slice(slice(span.start, span.stop))


def needed_arrays(plan: Plan) -> Iterator[tuple[ArraySpec, dict[str, int], str]]:
    """(spec, shape, camera path or "") of every array of every stage that may run, has something to do and waits for
    no effect's decision; and of those that are shorter than what is fresh of them, because a run of fewer frames was
    stopped before it made any: what lies in their shards is whole."""
    context = plan.context
    for stage in STAGES:
        if stage.name in plan.unneeded or stage.name in context.waits:
            continue
        verdicts = [v for v in plan.verdicts.values() if v.task.stage == stage.name]
        fresh = [v.task.partition for v in verdicts if v.state is State.FRESH]
        runs = plan.selection.allows(stage.name) and len(fresh) < len(verdicts)
        end = max((context.grid.bounds(p).stop for p in fresh if p is not None), default=0)
        for spec, shape, path in _arrays_of(context, stage):
            if runs:
                yield spec, shape, path
            elif end and context.sequence.lacks_frames(spec, cut := {**shape, "frame": end}, path):
                yield spec, cut, path


def _arrays_of(context: Context, stage: Stage) -> Iterator[tuple[ArraySpec, dict[str, int], str]]:
    """(spec, shape, camera path or "") of a stage's arrays."""
    for spec in stage.writes_for(context.facts):
        if isinstance(spec, ArraySpec):
            for path in context.paths if "path" in stage.over else [None]:
                yield spec, context.shape(path), path or ""


def counted_on(plan: Plan) -> dict[str, str]:
    """{array: its type, dimensions and lengths, as a digest} of all that a run of the plan makes or finds fresh, of
    stages that wait for no effect's decision."""
    context = plan.context
    stages = (s for s in STAGES if s.name not in plan.unneeded and s.name not in context.waits)
    return {
        spec.name.format(path=path): digest([spec.dtype, list(spec.dims), list(spec.lengths(shape))])
        for stage in stages
        for spec, shape, path in _arrays_of(context, stage)
    }


def prepare(plan: Plan) -> None:
    """Make, grow or replace the arrays of every stage that has something to do, and write the cameras beside the
    pictures, but not those of pictures that may not be made for these settings."""
    sequence = plan.context.sequence
    for spec, shape, path in needed_arrays(plan):
        sequence.ensure_array(spec, shape, path)
    if _as_set(plan, "frames"):
        sequence.put_rig("frames", plan.context.rig)
    for name, values in _beside(plan.context).items():
        if _as_set(plan, name.partition("/")[0]):
            sequence.put(name, *values)


def _as_set(plan: Plan, stage: str) -> bool:
    """Whether what the stage made is, or will be, of these settings; while it waits for a decision that is open, its
    arrays may yet be refused."""
    if stage in plan.context.waits:
        return False
    own = [v.state for v in plan.verdicts.values() if v.task.stage == stage]
    return plan.selection.allows(stage) or all(state is State.FRESH for state in own)


def lacks_description(plan: Plan) -> bool:
    """Whether `prepare` has something to do for a sequence of which all is fresh: cameras or times beside the pictures
    are not there, which `verify --repair` takes away where they are damaged, times are those of another frame rate, or
    arrays are shorter than they were."""
    context = plan.context
    names = ("frames/intrinsics", "frames/world_to_camera", "frames/size", *_beside(context))
    there = all(context.sequence.place(f"{name}/zarr.json").is_file() for name in names)
    return not there or not _has_times(context) or next(needed_arrays(plan), None) is not None


def _has_times(context: Context) -> bool:
    """Whether `frames/time` was written of these times, as its description says."""
    try:
        attributes = read_metadata(context.sequence.place("frames/time"))["attributes"]
    except (ForeignArray, FileNotFoundError):
        return False
    return bool(attributes.get("digest") == array_digest(context.time))


def _beside(context: Context) -> dict[str, tuple[np.ndarray, tuple[str, ...], str, str]]:
    """{array: (values, dimensions, unit, meaning)} of times and camera paths, for other readers of Zarr."""
    found: dict[str, tuple[np.ndarray, tuple[str, ...], str, str]] = {
        "frames/time": (context.time, ("frame",), "s", "Source frame number over frame rate."),
        "frames/valid": (context.valid, ("frame", "view"), "1", "Whether the view has a picture of the frame."),
        "frames/number": (context.source_frames, ("frame",), "1", "Source frame number."),
    }
    # Until it is known which cameras are believed, paths may come to go elsewhere.
    for name, cameras in ({} if context.cameras_undecided else context.paths).items():
        prefix = f"rendering/{name}"
        found[f"{prefix}/intrinsics"] = (
            cameras.intrinsics,
            ("frame", "camera", *INTRINSICS_AXES),
            "px",
            "Our pixel centres.",
        )
        found[f"{prefix}/world_to_camera"] = (
            cameras.world_to_camera,
            ("frame", "camera", *POSE_AXES),
            "m",
            "Rigid motion, OpenCV axes.",
        )
        found[f"{prefix}/served"] = (cameras.served, ("frame", "camera"), "1", "Whether the camera serves the frame.")
    return found
