"""When bytes that can be made again are given up: `keep` of every array, carried out while a run goes.

| keep | the bytes of one partition of an array go |
| --- | --- |
| always | never; `gc` does not offer them either |
| until_done | once every task that reads them is done and fresh; what no task reads is a result and stays |
| never | once no task of the run will read them any more, whether it succeeded or not, and also if none ever did |

The receipt stays with the content digests, so everything made from dropped bytes stays fresh. Default is
`run.keep: everything`: the next thing people do after a run is to export another path, look at a contact sheet or change a
rendering setting, and each of these reads the pictures and Gaussians of every frame; a first-time user with a short
sequence would recompute nearly all of it by surprise. Disk is the smaller trouble there, and `plan` says before the start
what it costs. `run.keep: as_declared` is for the night with a hundred sequences, `keep: {ARRAY: ...}` for single arrays,
and `posegaussian gc` drops afterwards what a run could have dropped.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from dags import presence
from dags.context import Context
from dags.events import Event, TaskBlocked, TaskDone, TaskFailed, TaskFresh, TaskLeftOut, TaskNeeded
from dags.plan import Plan, State
from dags.tasks import PRODUCERS, Product, Task, inputs
from dags.wording import number
from storage.capture import PER_VIEW
from storage.errors import NotWritten
from storage.receipts import Output
from storage.spec import ArraySpec, Keep
from storage.sweep import bytes_of, drop_outputs

Part = tuple[str, int | None]
"""An array (path filled in) and a partition: what is dropped together, over all views."""


def policy(settings: Any, spec: ArraySpec, declared: bool = False) -> Keep:
    """How long an array is kept under the settings; `declared`: as if run.keep were as_declared."""
    explicit = settings.keep.get(spec.name)
    if explicit is not None:
        return explicit
    return spec.keep if declared or settings.run.keep == "as_declared" else "always"


def droppable(settings: Any, declared: bool = False) -> dict[str, Keep]:
    """{declared array: until_done or never} of the arrays that may be dropped at all."""
    found = {name: policy(settings, spec, declared) for name, (stage, spec) in PRODUCERS.items() if isinstance(spec, ArraySpec) and not stage.sequence_wide}
    return {name: keep for name, keep in found.items() if keep != "always"}


def lost_source(context: Context) -> Path | None:
    """A source file that is not where it was imported from: without it dropped bytes could not be made again."""
    capture = context.capture
    streams = [s for kind in PER_VIEW for s in capture.streams(kind)] + [capture.joints3d]
    files = (Path(f.path) for s in streams if s is not None for f in s.files)
    return next((f for f in files if not f.is_file()), None)


class Readers:
    """Which tasks of a plan make and read each droppable part."""

    def __init__(self, plan: Plan, keeps: dict[str, Keep]) -> None:
        """Looks at declarations only."""
        self.context, self.keeps = plan.context, keeps
        self.keep: dict[Part, Keep] = {}
        self.makers: dict[Part, list[Task]] = defaultdict(list)
        self.of: dict[Part, list[Task]] = defaultdict(list)
        self.by: dict[Task, list[Part]] = defaultdict(list)
        """Parts a task makes or reads."""
        if not keeps:
            return
        for task in (t for t in plan.verdicts if t.stage not in plan.unneeded):
            for name in [n for n in keeps if PRODUCERS[n][0].name == task.stage]:
                part = (name.format(path=task.path), task.partition)
                self.keep[part] = keeps[name]
                self.makers[part].append(task)
                self.by[task].append(part)
            for i in inputs(plan.context, task):
                for part in {(p.array, p.partition) for p in i.products if i.read.array in keeps}:
                    self.of[part].append(task)
                    self.by[task].append(part)

    def due(self, part: Part, fresh: set[Task], ended: set[Task]) -> bool:
        """Whether a part may go, given the tasks that are fresh and those that ended in any way."""
        readers = self.of.get(part, [])
        if self.keep[part] == "never":
            return all(r in ended for r in readers)
        return bool(readers) and all(r in fresh for r in readers)


class Keeper:
    """A listener that drops outputs as soon as their `keep` says so."""

    def __init__(self, plans: Iterable[Plan]) -> None:
        """Nothing is dropped of a sequence whose sources are not all there."""
        self.plans = {p.context.sequence.name: p for p in plans}
        self._refused: list[str] = []
        self.readers: dict[str, Readers] = {}
        self.fresh: set[Task] = set()
        self.ended: set[Task] = set()
        self.outputs, self.bytes = 0, 0
        for name, plan in self.plans.items():
            keeps = droppable(plan.context.settings)
            lost = lost_source(plan.context) if keeps else None
            if lost is not None:
                self._refused.append(f"{name}: nothing is dropped, because {lost} is not there and dropped bytes could not be made again")
            self.readers[name] = Readers(plan, {} if lost is not None else keeps)

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, TaskDone | TaskFresh):
            self.fresh.add(event.task)
            self.ended.add(event.task)
            self._drop(event.task)
        elif isinstance(event, TaskFailed | TaskBlocked | TaskLeftOut):
            self.ended.add(event.task)
            self._drop(event.task)
        elif isinstance(event, TaskNeeded):
            self.fresh.discard(event.task)
            self.ended.discard(event.task)

    @property
    def sentences(self) -> list[str]:
        """What the user should know after the run."""
        dropped = f"dropped {number(self.outputs, 'output')} that no task needs any more, {self.bytes / 1e6:.1f} MB; they are made again where something needs them (run.keep, keep)"
        return [*self._refused, *([dropped] if self.outputs else [])]

    def sweep(self) -> None:
        """Drop what a run in which every task is fresh would drop."""
        for plan in self.plans.values():
            for task in plan.verdicts:
                self(TaskFresh(task))

    def _drop(self, task: Task) -> None:
        """Drop what a task made or read, as far as it is due now; nothing while another run may be reading it."""
        plan, readers = self.plans[task.sequence], self.readers[task.sequence]
        if readers.context is not plan.context:  # an effect was decided since: other tasks, other inputs
            readers = self.readers[task.sequence] = Readers(plan, readers.keeps)
        chosen: dict[Task, set[tuple[str, int | None]]] = defaultdict(set)
        for part in readers.by.get(task, ()):
            if readers.due(part, self.fresh, self.ended):
                for maker in readers.makers[part]:
                    if maker in self.fresh:
                        chosen[maker] |= {(o.array, o.view) for o in _kept(plan, maker) if o.array == part[0]}
        if any(chosen.values()) and not presence.others(plan.context.sequence):
            for maker, outputs in chosen.items():
                self._give_up(plan, maker, outputs)

    def _give_up(self, plan: Plan, maker: Task, outputs: set[tuple[str, int | None]]) -> None:
        before = plan.book.receipts[maker]
        try:
            after = drop_outputs(plan.context.sequence, before, outputs)
        except NotWritten as e:  # a receipt has to say so first
            self._refused = list(dict.fromkeys([*self._refused, f"{maker.sequence}: not all that could go was dropped: {e}"]))
            return
        plan.book.receipts[maker] = after
        gone = [a for b, a in zip(before.outputs, after.outputs, strict=True) if a.dropped and not b.dropped]
        self.outputs += len(gone)
        self.bytes += sum(bytes_of(o.files) for o in gone)


def _kept(plan: Plan, maker: Task) -> Iterator[Output]:
    """Outputs of a task that are on disk and that no export asked for."""
    for o in plan.book.receipts[maker].outputs:
        if not o.dropped and Product(o.array, maker.partition, o.view) not in plan.book.held:
            yield o


def settled_outputs(plan: Plan, keeps: dict[str, Keep]) -> Iterator[tuple[Task, Output]]:
    """Outputs on disk that a run with these policies would have dropped: their readers in the plan are all fresh."""
    fresh = {t for t, v in plan.verdicts.items() if v.state is State.FRESH}
    readers = Readers(plan, keeps)
    for part, makers in readers.makers.items():
        if readers.due(part, fresh, fresh):
            for maker in makers:
                if maker in fresh:
                    yield from ((maker, o) for o in _kept(plan, maker) if o.array == part[0])
