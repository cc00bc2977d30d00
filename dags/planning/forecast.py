"""What a run is expected to take, before it starts: bytes on disk, memory of a task, seconds; and refusal where that
cannot be, warning where only a guess says so.

Bytes come from the declarations and the shape of the sequence, times the compression that the archive's own history
shows; memory from what each stage declares that a task needs; seconds from the history, in proportion to frames x views
x pixels. Where the archive has no history of a stage, what the stage declares as typical stands in, and is called a
guess wherever it is said.
"""

from __future__ import annotations

import shutil
import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

from posegaussian.dags.humanize.text import gigabytes
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.resources import cpu_workers
from posegaussian.dags.planning.retention import droppable
from posegaussian.dags.planning.set_aside import replaced
from posegaussian.dags.planning.task_cost import Load, load, raw_bytes
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.planning.variants import variants
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import ledger, set_aside
from posegaussian.storage.archive.deletion import bytes_of
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.spec import digest

COLUMNS = (*ledger.KEY, "state", "started", "seconds", "bytes", "raw_bytes", "work", "unit", "params", "effects")
"""What of the ledger the rates are taken from."""

RECENT = 500
"""Newest tasks of a stage that its history is taken from."""

AHEAD = 2
"""Partitions whose droppable arrays lie on disk besides those that the workers have in hand: tasks are done depth
first."""


_LESS = (
    "set run.keep to as_declared, choose a smaller frames.size or a shorter frames.range, or make room"
    " (`posegaussian gc` says what could go)"
)

Timed = Literal["same settings", "other settings", "guess"]
"""Where seconds come from: tasks of the stage in this archive, under its settings or others, or what is typical; the
surest first."""


@dataclass(frozen=True)
class Rate:
    """What is expected of one stage."""

    ratio: float
    """Bytes on disk over bytes before compression."""
    compressed: bool
    """Whether the ratio was measured in this archive; else it is a guess."""
    seconds: float
    """Seconds of a task per unit of work, median."""
    timed: Timed
    """Where they come from."""


class History:
    """The archive's finished tasks, for rates."""

    def __init__(self, rows: Iterable[Mapping[str, Any]] = ()) -> None:
        """`rows` of the ledger."""
        self._rows: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
        for row in rows:
            if row.get("state") == "done" and row.get("work") and row.get("seconds") is not None:
                self._rows[row["stage"]].append(row)
        for found in self._rows.values():
            found.sort(key=lambda r: r["started"] or "")
            del found[:-RECENT]

    @classmethod
    def read(cls, archive: Archive) -> History:
        """From the ledgers of an archive and of its variants; what a variant took over counts once."""
        rows = [row for a in (archive, *variants(archive)) for row in ledger.read(a, COLUMNS)]
        return cls({(*(row[k] for k in ledger.KEY), row["state"], row["started"]): row for row in rows}.values())

    @property
    def timed(self) -> list[Mapping[str, Any]]:
        """The tasks that seconds are taken from, of all stages: those whose work was counted as it is now."""
        return [row for stage in STAGES for row in self._timed(stage)]

    def _timed(self, stage: Stage) -> list[Mapping[str, Any]]:
        return [row for row in self._rows.get(stage.name, []) if row["unit"] == stage.unit.name]

    def rate(self, stage: Stage, params: Any) -> Rate:
        """Rates of a stage; seconds of tasks with the same settings where there are any, else of all, else typical
        ones."""
        rows, timed = self._rows.get(stage.name, []), self._timed(stage)
        raw = sum(r["raw_bytes"] or 0 for r in rows)
        now = digest(params.hashed())
        same = [r for r in timed if r["params"] == now]
        seconds = [r["seconds"] / r["work"] for r in same or timed]
        return Rate(
            sum(r["bytes"] for r in rows) / raw if raw else stage.typical.ratio,
            bool(raw),
            statistics.median(seconds) if seconds else stage.typical.seconds,
            "same settings" if same else "other settings" if timed else "guess",
        )


@dataclass(frozen=True)
class Projection:
    """What the tasks of one stage that are not fresh are expected to take; undecided ones count as if they ran."""

    stage: str
    tasks: int
    disk: int
    """Bytes written."""
    replaced: int
    """Bytes now on disk that they take the place of."""
    peak: int
    """Bytes on disk at most at one time, of what `keep` lets go in between."""
    compressed: bool
    """Whether `disk` follows from compression that was measured in this archive; else it is a guess."""
    ram: int
    """Peak of a task's process, bytes."""
    vram: int
    """Peak of a task's device memory, bytes."""
    seconds: float
    """Of all tasks together, one after the other."""
    timed: Timed
    """Where the seconds come from."""


def project(plan: Plan, history: History) -> list[Projection]:
    """One projection for each stage that has something to do."""
    found = []
    for stage in STAGES:
        todo = [t for t in plan.to_make if t.stage == stage.name]
        if todo:
            found.append(_of_stage(plan, stage, todo, history.rate(stage, plan.context.params(stage))))
    return found


def together(of_each: Iterable[Sequence[Projection]]) -> list[Projection]:
    """Projections of many sequences as one for each stage; what is a guess of one is a guess of all."""
    by_stage: dict[str, list[Projection]] = {}
    for p in chain.from_iterable(of_each):
        by_stage.setdefault(p.stage, []).append(p)
    return [
        Projection(
            stage.name,
            sum(p.tasks for p in found),
            sum(p.disk for p in found),
            sum(p.replaced for p in found),
            sum(p.peak for p in found),
            all(p.compressed for p in found),
            max(p.ram for p in found),
            max(p.vram for p in found),
            sum(p.seconds for p in found),
            max((p.timed for p in found), key=get_args(Timed).index),
        )
        for stage in STAGES
        if (found := by_stage.get(stage.name))
    ]


def _of_stage(plan: Plan, stage: Stage, todo: list[Task], rate: Rate) -> Projection:
    context, loads = plan.context, Loads(plan.context)
    of_each = [loads(t) for t in todo]
    disk = sum(load.raw_bytes for load in of_each) * rate.ratio
    receipts = [plan.book.receipts[t] for t in todo if t in plan.book.receipts]
    replaced = sum(bytes_of(o.files) for r in receipts for o in r.outputs if not o.dropped)
    return Projection(
        stage.name,
        len(todo),
        round(disk),
        replaced,
        round(disk - _let_go(context, todo) * rate.ratio),
        rate.compressed,
        max(load.ram for load in of_each),
        max(load.vram for load in of_each),
        rate.seconds * sum(load.work for load in of_each),
        rate.timed,
    )


class Loads:
    """Loads of a sequence's tasks, worked out once for every stage, path and length of a partition."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.known: dict[tuple[str, str | None, int], Load] = {}

    def __call__(self, task: Task) -> Load:
        """What one task is expected to take."""
        key = (
            task.stage,
            task.path,
            len(self.context.grid.bounds(task.partition)) if task.partition is not None else 0,
        )
        if key not in self.known:
            self.known[key] = load(self.context, task)
        return self.known[key]


def _let_go(context: Context, todo: list[Task]) -> int:
    """Bytes before compression that are dropped again before the last tasks write theirs."""
    run = context.settings.run
    alive = cpu_workers(run) * run.window + AHEAD
    keeps = droppable(context.settings)
    of_each = raw_bytes(context, todo[0], context.grid.length)
    one = sum(n for name, n in of_each.items() if name in keeps)
    partitions = {t.partition for t in todo}
    return one * max(0, len(partitions) - alive) * len(todo) // len(partitions)


@dataclass(frozen=True)
class Disk:
    """What a run is projected to write beyond what it replaces, and what there is room for; all in bytes."""

    measured: int
    """Of stages whose compression was measured in this archive."""
    guessed: int
    """Of the others."""
    free: int
    """Free on the disk, with what other settings' results would make room for."""
    root: Path
    """The archive's folder."""

    @classmethod
    def of(cls, plans: Sequence[Plan], archive: Archive, history: History) -> Disk:
        """Of these plans; what may turn out not to run does not count."""
        need = {True: 0, False: 0}
        for plan in plans:
            for p in project(plan, history):
                if p.stage not in plan.context.perhaps_unneeded:
                    need[p.compressed] += p.peak - p.replaced
        free = shutil.disk_usage(archive.root).free + sum(e.own for e in set_aside.entries(archive))
        return cls(need[True], need[False], free, archive.root)

    @property
    def certain(self) -> int:
        """What is needed whatever the guesses come to; what they replace makes room."""
        return self.measured + min(0, self.guessed)

    def refusals(self) -> list[str]:
        """Why a run should not start, with what to change: on measured figures only. Memory is refused by
        `posegaussian.dags.planning.resources`, worker by worker."""
        if self.certain <= self.free:
            return []
        warning = (
            f"the run is projected to need {gigabytes(self.certain)} more on disk, an estimate after compression;"
            f" {self.root} has {gigabytes(self.free)} free; {_LESS}"
        )
        return [warning]

    def doubts(self) -> list[str]:
        """That the disk may not hold it, where that hangs on a guess and is no reason to refuse."""
        if self.certain > self.free or self.measured + self.guessed <= self.free:
            return []
        warning = (
            f"the run may need {gigabytes(self.measured + self.guessed)} more on disk, of which"
            f" {gigabytes(self.guessed)} are a guess, and {self.root} has {gigabytes(self.free)} free: a run of a few"
            " frames (--set frames.range=0:16) measures it, and one that fills the disk goes on from there once there"
            f" is room; {_LESS}"
        )
        return [warning]


@dataclass(frozen=True)
class Room:
    """What may lie aside once some plans have run."""

    bytes: int
    """So many bytes: the setting's, or what the disk leaves."""
    over: int
    """So many bytes that lie there or would come there do not fit: they are deleted."""
    by_disk: bool
    """Whether the disk is what limits it."""

    def sentences(self, setting: str) -> list[str]:
        """What is deleted; `setting`: run.keep_variants as written."""
        if self.over <= 0:
            return []
        bound = "the disk holds no more" if self.by_disk else f"run.keep_variants is {setting}"
        note = (
            f"up to {gigabytes(self.over)} of results of other settings will be deleted, those unused for the longest"
            f" time first: {bound}"
        )
        return [note]


def room(plans: Sequence[Plan], archive: Archive, history: History) -> Room:
    """How much may lie aside: `run.keep_variants`, less where the run itself needs the disk."""
    wanted = plans[0].context.settings.run.kept_bytes if plans else 0
    coming = sum(bytes_of(o.files) for p in plans for r in replaced(p) for o in r.outputs)
    coming_back = {set_aside.place_of(p.context.sequence, r) for p in plans for r in p.book.kept.values()}
    lying = sum(e.own for e in set_aside.entries(archive) if e.folder not in coming_back)
    need = sum(p.peak for plan in plans for p in project(plan, history))
    disk = lying + coming + shutil.disk_usage(archive.root).free - need
    bound = max(0, min(wanted, disk))
    return Room(bound, lying + coming - bound, disk < wanted)
