"""Which tasks a sequence has, and which task makes what another one reads. Integers and names only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from posegaussian.dags.planning.context import Context
from posegaussian.stages.contract.declaration import Read, Stage
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.spec import ArraySpec, TableSpec


class Task(NamedTuple):
    """One unit of work, and the key of its receipt."""

    sequence: str
    """Name of the sequence."""
    stage: str
    """Name of the stage."""
    partition: int | None = None
    """Partition along time, or None for a task of the whole sequence."""
    view: int | None = None
    """View, for stages that run over views."""
    path: str | None = None
    """Camera path, for stages that run over paths."""

    def label(self, names: tuple[str, ...] = ()) -> str:
        """`frames cam01 p0003`, as shown to people."""
        view = None if self.view is None else names[self.view] if names else f"view {self.view}"
        parts = [self.stage, self.path, view, None if self.partition is None else f"p{self.partition:04d}"]
        return " ".join(p for p in parts if p)


class Product(NamedTuple):
    """One (array, partition, view) that a task writes and another may read; `array` has its path filled in."""

    array: str
    partition: int | None
    view: int | None


class Input(NamedTuple):
    """What one task reads of one array."""

    read: Read
    """The declaration."""
    spec: ArraySpec
    """The array."""
    name: str
    """Its name, path filled in."""
    span: range
    """Frames, halo included; empty for arrays without a frame axis."""
    views: tuple[int | None, ...]
    """Views that are read."""
    products: tuple[Product, ...]
    """What must exist."""


PRODUCERS: dict[str, tuple[Stage, ArraySpec | TableSpec]] = {w.name: (s, w) for s in STAGES for w in s.writes}
"""Declared output -> (its stage, its spec)."""


def tasks(context: Context) -> Iterator[Task]:
    """All tasks of a sequence, in the order of flow."""
    gone = context.unneeded()
    for stage in STAGES:
        if stage.name not in gone:
            yield from tasks_of(context, stage)


def tasks_of(context: Context, stage: Stage) -> Iterator[Task]:
    """All tasks of one stage, needed or not."""
    partitions = list(context.grid.partitions) if "time" in stage.over else [None]
    views = list(context.active_views) if "view" in stage.over else [None]
    paths = _paths(context, stage) if "path" in stage.over else [None]
    for path in paths:
        for partition in partitions:
            for view in views:
                yield Task(context.sequence.name, stage.name, partition, view, path)


def _paths(context: Context, stage: Stage) -> list[str]:
    """Paths a stage works on: those with truth for a stage that compares with held-out pictures, else all."""
    compares = any(r.views == "held_out" for r in stage.reads)
    return [name for name, p in context.paths.items() if p.kind == "held_out" or not compares]


def inputs(context: Context, task: Task) -> tuple[Input, ...]:
    """What a task reads, of every array it declares."""
    last = context.memo.get("inputs")
    if last is not None and last[0] == task:
        return last[1]
    found = []
    for read, spec, halo in _array_reads(context, task.stage):
        name = read.array.format(path=task.path) if task.path else read.array
        span = _span(context, task, halo) if spec.per_frame else range(0)
        views = selected_views(context, read, task) if spec.per_view else (None,)
        partitions = list(context.grid.touched(span)) if spec.per_frame else [None]
        found.append(
            Input(read, spec, name, span, views, tuple([Product(name, p, v) for p in partitions for v in views]))
        )
    context.memo["inputs"] = (task, tuple(found))  # a plan asks several times in a row; keeping all would cost memory
    return tuple(found)


def _span(context: Context, task: Task, halo: tuple[int, int]) -> range:
    """Frames that a task reads: its partition's with the halo; all of them in a task of the whole sequence."""
    return range(context.grid.frames) if task.partition is None else context.grid.span(task.partition, halo)


def _array_reads(context: Context, name: str) -> list[tuple[Read, ArraySpec, tuple[int, int]]]:
    """(read, array, halo) of the arrays that a stage reads under the context's settings."""
    key = ("reads", name)
    if key not in context.memo:
        stage = next(s for s in STAGES if s.name == name)
        params, found = context.params(stage), []
        for read in stage.reads_for(params, context.facts):
            if not read.is_source:
                spec = PRODUCERS[read.array][1]
                assert isinstance(spec, ArraySpec), f"{name} reads {read.array}, which is a table"
                found.append((read, spec, read.halo_for(params, context.facts)))
        context.memo[key] = found
    return context.memo[key]


def worked_frames(context: Context, task: Task) -> range:
    """Frame indices that a task produces: its partition's; all of them in a task of the whole sequence, none in one
    that takes constants of a sample."""
    if task.partition is not None:
        return context.grid.bounds(task.partition)
    stage = next(s for s in STAGES if s.name == task.stage)
    return range(0) if stage.sequence_wide else range(context.grid.frames)


def source_spans(context: Context, task: Task) -> dict[str, range]:
    """{source: frame indices that a task works on}, halo included; all of them for a task of the whole sequence."""
    stage = next(s for s in STAGES if s.name == task.stage)
    params, every = context.params(stage), range(context.grid.frames)
    return {
        r.array: every
        if task.partition is None
        else context.grid.span(task.partition, r.halo_for(params, context.facts))
        for r in stage.reads_for(params, context.facts)
        if r.is_source
    }


def path_frames(context: Context, task: Task) -> range:
    """Frames of which a task may see its camera path: its partition's, and those of what it reads along the path. The
    halo of any other array is none of the path's."""
    assert task.partition is not None, f"{task.stage} runs over paths but not over time"
    along = (i for i in inputs(context, task) if i.read.along_path)
    spans = [context.grid.bounds(task.partition), *(i.span for i in along)]
    return range(min(s.start for s in spans), max(s.stop for s in spans))


def selected_views(context: Context, read: Read, task: Task) -> tuple[int, ...]:
    """Views that a read means for one task."""
    if read.views == "own":
        assert task.view is not None, f"{task.stage} reads its own view of {read.array} but does not run over views"
        return (task.view,)
    views = context.views_of(next(s for s in STAGES if s.name == task.stage))
    return {
        "sources": views.sources,
        "held_out": views.held_out,
        "compared": (*views.sources, *views.held_out),
        "all": tuple(range(len(context.rig))),
    }[read.views]


def producer(product: Product, task: Task) -> Task:
    """The task that writes a product, for a reader of the same sequence and path."""
    declared = product.array.replace(task.path, "{path}") if task.path else product.array
    stage, _ = PRODUCERS[declared]
    return Task(
        task.sequence,
        stage.name,
        product.partition if "time" in stage.over else None,
        product.view if "view" in stage.over else None,
        task.path if "path" in stage.over else None,
    )


def dependencies(context: Context, task: Task) -> tuple[Task, ...]:
    """Tasks that must be done before this one, each once: what it reads, and those of sequence-wide stages while a
    decision waits for their word."""
    read = [producer(p, task) for i in inputs(context, task) for p in i.products]
    return tuple(dict.fromkeys([*read, *deciding(context, task.stage)]))


def deciding(context: Context, stage: str) -> tuple[Task, ...]:
    """Tasks of sequence-wide stages that a stage waits for."""
    waited = {PRODUCERS[array][0].name: PRODUCERS[array][0] for array in context.waits.get(stage, ())}
    return tuple(t for s in waited.values() for t in measuring(context, s))


def measuring(context: Context, stage: Stage) -> tuple[Task, ...]:
    """The tasks of a sequence-wide stage whose notes decide: those of all views that are sources to it, or its only
    one."""
    views = context.views_of(stage).sources if "view" in stage.over else (None,)
    return tuple(Task(context.sequence.name, stage.name, None, v) for v in views)
