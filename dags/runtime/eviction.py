"""Outputs that nothing needs any more are dropped while a run goes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.retention import Readers, droppable, kept_outputs, lost_source
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.events import (
    Event,
    TaskBlocked,
    TaskDone,
    TaskFailed,
    TaskFresh,
    TaskLeftOut,
    TaskNeeded,
)
from posegaussian.storage.archive.deletion import bytes_of, drop_outputs
from posegaussian.storage.model.errors import NotWritten


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
                self._refused.append(
                    f"{name}: nothing is dropped, because {lost} is not there and dropped bytes could not be made again"
                )
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
        dropped = (
            f"dropped {number(self.outputs, 'output')} that no task needs any more, {self.bytes / 1e6:.1f} MB; they are"
            " made again where something needs them (run.keep, keep)"
        )
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
                        chosen[maker] |= {(o.array, o.view) for o in kept_outputs(plan, maker) if o.array == part[0]}
        if any(chosen.values()) and not run_registry.others(plan.context.sequence):
            for maker, outputs in chosen.items():
                self._give_up(plan, maker, outputs)

    def _give_up(self, plan: Plan, maker: Task, outputs: set[tuple[str, int | None]]) -> None:
        before = plan.book.receipts[maker]
        try:
            after = drop_outputs(plan.context.sequence, before, outputs)
        except NotWritten as e:  # a receipt has to say so first
            self._refused = list(
                dict.fromkeys([*self._refused, f"{maker.sequence}: not all that could go was dropped: {e}"])
            )
            return
        plan.book.receipts[maker] = after
        gone = [a for b, a in zip(before.outputs, after.outputs, strict=True) if a.dropped and not b.dropped]
        self.outputs += len(gone)
        self.bytes += sum(bytes_of(o.files) for o in gone)
