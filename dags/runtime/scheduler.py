"""The run loop: judge tasks as their inputs become known, hand the stale ones to a back end, let failures fail
alone."""

from __future__ import annotations

import heapq
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from posegaussian.dags.planning.effects import EffectVerdict
from posegaussian.dags.planning.plan import Plan, State, TaskVerdict, judge, kept_result, take_decisions
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.set_aside import put_aside
from posegaussian.dags.planning.tasks import Task, deciding, dependencies, tasks
from posegaussian.dags.provenance import builds
from posegaussian.dags.provenance.code_digest import code_digest
from posegaussian.dags.runtime.entering import enter, make_arrays
from posegaussian.dags.runtime.events import (
    EffectsDecided,
    Event,
    Listener,
    Notice,
    RunEnded,
    RunStarted,
    TaskBlocked,
    TaskDone,
    TaskFailed,
    TaskFresh,
    TaskLeftOut,
    TaskNeeded,
    TasksChanged,
)
from posegaussian.dags.runtime.failures import Failure, Kind, failure
from posegaussian.dags.runtime.in_flight import Backend, Flight, Rules
from posegaussian.dags.runtime.ordering import make_order
from posegaussian.dags.runtime.run_registry import Presence
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.receipts import Receipt, ReceiptKey, damaged_files
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import LeaseHeld, LeaseLost, OtherCode, SchedulerLost
from posegaussian.storage.model.spec import digest

DEPTH = {s.name: i for i, s in enumerate(STAGES)}
"""Position of a stage in the flow; deeper work goes first, so that finished pictures appear early."""


class Run:
    """One run over some sequences."""

    def __init__(
        self,
        plans: Sequence[Plan],
        selection: Selection,
        backend: Backend,
        listeners: Iterable[Listener],
        threads: int = 1,
        rules: Rules | None = None,
        more: bool = False,
    ) -> None:
        """Nothing is touched before `go`. `more`: another run will follow on the same back end, which is left open."""
        self.plans = {p.context.sequence.name: p for p in plans}
        self.selection, self.backend, self.listeners, self.threads = selection, backend, tuple(listeners), threads
        self.rules, self.more = rules or Rules(), more
        self.flight = Flight(backend, self.rules, self.tell)
        self.presences: list[Presence] = []
        self.order = {task: i for i, task in enumerate(t for p in plans for t in p.verdicts)}
        self.waiting: dict[Task, set[Task]] = {}
        self.dependents: dict[Task, list[Task]] = defaultdict(list)
        self.out: set[Task] = set()
        """Queued or in a worker's hand."""
        self.behind: dict[Task, list[Task]] = defaultdict(list)
        """By task in `out`: tasks that will write what it reads, and wait until it is through."""
        self.before: dict[Task, Receipt] = {}
        """Receipts of tasks that were opened again."""
        self.mended: set[Task] = set()
        """Tasks whose damaged inputs were made again once."""
        self.ready: list[tuple[int, int, Task]] = []
        self.reasons: dict[Task, tuple[str, ...]] = {}
        self.taken = 0
        """Tasks whose results of an earlier run were taken over."""
        self.ended: dict[Task, str] = {}
        """How each settled task ended: done, fresh, failed, blocked, left_out, or unneeded by an effect's decision."""

    def tell(self, event: Event) -> None:
        """Give an event to every listener."""
        for listener in self.listeners:
            listener(event)

    def go(self) -> RunEnded:
        """Run to the end; a keyboard interrupt stops handing out tasks and ends the run.

        Raises OtherCode before anything is touched when files of this process were edited since it began.
        """
        start, interrupted = time.perf_counter(), False
        self._fix_code()
        self.tell(RunStarted(tuple(self.order), self.backend.sentences))
        try:
            self._link()
            self._put_aside()
            for plan in self.plans.values():
                self._enter(plan)
            self._loop()
        except KeyboardInterrupt:
            interrupted = True
        except (SchedulerLost, OtherCode) as e:
            self._abandon(failure(e))
        finally:
            if interrupted or not self.more:
                self.backend.close(hard=interrupted)
            for presence in self.presences:
                presence.drop()
        counts = Counter(self.ended.values())
        ended = RunEnded(
            **{k: counts[k] for k in ("done", "fresh", "failed", "blocked", "left_out")},
            seconds=time.perf_counter() - start,
            interrupted=interrupted,
            taken=self.taken,
        )
        self.tell(ended)
        return ended

    def _fix_code(self) -> None:
        """Read all code now: of a file that is edited later nobody could say what a worker imported. Raises
        OtherCode."""
        try:
            builds.here()
            for stage in STAGES:
                code_digest(stage.run)
        except OtherCode:
            self.backend.close(hard=True)
            raise

    def _put_aside(self) -> None:
        """Put aside what the run replaces, sequence by sequence, then keep what lies there to its budget: once, as
        that looks at all of the archive."""
        room = self.rules.terms.kept
        if room is None:
            return
        plans, changing = [p for p in self.plans.values() if not p.all_fresh], dict[Path, int]()
        for plan in plans:
            with self._or_without(plan):
                changing.update(put_aside(plan, room))
        for root in {p.context.sequence.root.parent for p in plans}:
            with self._or_without(*plans):
                set_aside.shrink(Archive(root), room, changing)

    @contextmanager
    def _or_without(self, *plans: Plan, at: Task | None = None) -> Iterator[None]:
        """Where what is done for some sequences fails, the task `at`, or the first open one of each, fails, their other
        tasks are blocked but what a worker has in hand, and other sequences go on."""
        try:
            yield
        except Exception as e:
            for plan in plans:
                first = self._first_open(plan) if at is None or at in self.ended else at
                if first is not None:
                    self._fail(first, failure(e))
                    for task in plan.verdicts:
                        self._block(task, first)

    def _first_open(self, plan: Plan) -> Task | None:
        """The first task of a plan that is neither fresh nor settled nor in a worker's hand."""
        judged = ((t, v.state) for t, v in plan.verdicts.items() if t not in self.ended and t not in self.out)
        return next((t for t, state in judged if state is not State.FRESH), None)

    def _enter(self, plan: Plan) -> None:
        """Make a sequence's arrays and begin with it."""
        if self._first_open(plan) is not None:
            with self._or_without(plan):
                self.presences.append(enter(plan, self.rules.terms))
                plan.book = Book.open(plan.context, plan.book.held)
        for task in plan.verdicts:
            if not self.waiting[task] and task not in self.ended:
                self._push(task)

    def _link(self) -> None:
        """Note what every task waits for."""
        for plan in self.plans.values():
            for task in plan.verdicts:
                self._link_one(plan, task)

    def _link_one(self, plan: Plan, task: Task) -> None:
        before = [d for d in dependencies(plan.context, task) if d in self.order]
        self.waiting[task] = {d for d in before if d not in self.ended}
        for d in before:
            self.dependents[d].append(task)

    def _push(self, task: Task) -> None:
        heapq.heappush(self.ready, (-DEPTH[task.stage], self.order[task], task))

    def _loop(self) -> None:
        while True:
            while self.ready:
                task = heapq.heappop(self.ready)[2]
                try:
                    self._judge(task)
                except Exception as e:  # a fault in one task's plan must not end the night's run
                    self._fail(task, failure(e))
            settled = self.flight.next()
            if settled is None:
                return
            self._settle(*settled)

    def _judge(self, task: Task) -> None:
        """A task whose inputs are settled: fresh, or queued for a worker."""
        if self.waiting[task] or task in self.out or task in self.ended:
            return  # something it reads was opened again since it became ready
        plan = self.plans[task.sequence]
        if task.stage in plan.context.waits:
            self._decide(plan, task)
        if task in self.ended:
            return  # of a camera path that is none any more, or its arrays could not be made
        if task.stage in plan.context.waits and self._waits_for_more(plan, task):
            return
        if task.stage in plan.unneeded:
            self.tell(TaskFresh(task))
            self._release(task, "unneeded")
            return
        digests = plan.book.digests(task)
        assert digests is not None, f"{task.label()} became ready before its inputs"
        state, why, parts = judge(plan.book, task, self.selection, digests)
        if task in plan.book.needed:
            state, why = State.STALE, (*why, plan.book.needed[task])
        if state is State.FRESH:
            self.tell(TaskFresh(task))
            self._release(task, "fresh")
        elif not self.selection.allows(task.stage):
            self._block(task, task)
        elif self._take_over(plan, task, parts):
            pass
        elif dropped := plan.book.dropped_inputs(task):
            self._call_back(task, dropped)
        else:
            order = make_order(plan.context, plan.book, task, parts, self.threads)
            self.out.add(task)
            self.reasons[task] = why
            self.flight.add((-DEPTH[task.stage], self.order[task]), task, order)

    def _waits_for_more(self, plan: Plan, task: Task) -> bool:
        """Whether what was just decided leaves something open that was not before, such as whether anybody reads what
        the task makes once a stage that was named is off; the task then waits for what settles that, and is settled
        itself where that cannot run."""
        before = [d for d in deciding(plan.context, task.stage) if d in self.order]
        more = {d for d in before if d not in self.ended}
        lost = next((d for d in before if self.ended.get(d) in ("failed", "blocked", "left_out")), None)
        if not more and lost is not None:
            self._block(task, lost)
            return True
        self.waiting[task] |= more
        for d in more:
            self.dependents[d].append(task)
        return bool(more)

    def _take_over(self, plan: Plan, task: Task, parts: dict[str, Any]) -> bool:
        """Put what an earlier run made of the same in the task's place; False where there is none, or another run
        has the task in hand."""
        if kept_result(plan.context, task, self.selection, parts) is None:
            return False
        terms = self.rules.terms
        try:
            receipt = set_aside.take(
                plan.context.sequence, ReceiptKey(*task[1:]), digest(parts), terms.run, terms.lease
            )
        except (LeaseHeld, LeaseLost):
            return False
        if receipt is None:
            return False
        plan.book.add(task, receipt)
        self.taken += 1
        self.tell(TaskFresh(task))
        self._release(task, "fresh")
        self._compare(task, receipt)
        return True

    def _decide(self, plan: Plan, task: Task) -> None:
        """A sequence-wide stage is through: what it settles is decided, which cameras are believed among it, and the
        arrays behind that can be made; where they cannot, `task` fails and the rest of the plan is blocked."""
        name, open_cameras = plan.context.sequence.name, plan.context.cameras_undecided
        before = plan.context.paths.keys()
        decided = take_decisions(plan)
        if open_cameras and not plan.context.cameras_undecided:
            for verdict in plan.context.cameras.values():
                if verdict.overruled:
                    self.tell(Notice(f"{name}: {verdict.sentence}"))
        if plan.context.paths.keys() != before:
            self._change_paths(plan)
        effects = [v for v in decided if isinstance(v, EffectVerdict)]
        on, off = (tuple(v.effect.name for v in effects if v.state == state) for state in ("on", "off"))
        if decided:
            self.tell(EffectsDecided(name, tuple(v.sentence for v in decided), on, off))
        with self._or_without(plan, at=task):
            make_arrays(plan, self.rules.terms)

    def _change_paths(self, plan: Plan) -> None:
        """Camera paths go between cameras that are believed, as these stand: tasks of those that go elsewhere give way
        to others."""
        name, paths = plan.context.sequence.name, plan.context.paths
        gone = [t for t in self.order if t.sequence == name and t.path is not None and t.path not in paths]
        come = [t for t in tasks(plan.context) if t.path is not None and t not in self.order]
        if not gone and not come:
            return
        for task in come:
            self.order[task] = len(self.order)
            plan.verdicts[task] = TaskVerdict(
                task, State.UNDECIDED, ("other cameras are believed, or they stand otherwise",)
            )
        self.tell(TasksChanged(tuple(gone), tuple(come)))
        for task in gone:
            plan.verdicts.pop(task, None)
            self.ended[task] = "unneeded"
        for task in come:
            self._link_one(plan, task)
            if not self.waiting[task]:
                self._push(task)

    def _settle(self, task: Task, result: Receipt | Failure) -> None:
        self.out.discard(task)
        for writer in self.behind.pop(task, ()):
            self._wake(writer, task)
        if isinstance(result, Failure):
            if result.kind is not Kind.CORRUPT or not self._mend(task):
                self._fail(task, result)
            return
        self.plans[task.sequence].book.add(task, result)
        reasons = self.reasons.pop(task)
        own = result.facts.get("run") == self.rules.terms.run
        self.tell(TaskDone(task, result, reasons) if own else TaskFresh(task))
        self._release(task, "done" if own else "fresh")
        self._compare(task, result)

    def _compare(self, task: Task, result: Receipt) -> None:
        """Open again what read a task's earlier output, where it came out different."""
        before = self.before.pop(task, None)
        if before is not None and before.contents != result.contents:
            for dependent in [d for d in self.dependents[task] if self.ended.get(d) in ("done", "fresh")]:
                self._reopen(dependent, task)

    def _mend(self, task: Task) -> bool:
        """A task read a damaged shard: have what is damaged made again, then the task once more; returns whether
        that can be done."""
        if task in self.mended:
            return False
        plan = self.plans[task.sequence]
        damaged = {}
        for d in dependencies(plan.context, task):
            receipt = plan.book.receipts.get(d)
            if receipt is not None and (files := damaged_files(plan.context.sequence, receipt)):
                damaged[d] = f"shard {files[0]} is missing or damaged"
        if not damaged or not all(d in self.order and self.selection.allows(d.stage) for d in damaged):
            return False
        self.mended.add(task)
        for d, why in damaged.items():
            plan.book.problems[d] = why
            self.waiting[task].add(d)
            if d in self.ended:
                self._reopen(d, task)
        return True

    def _fail(self, task: Task, why: Failure) -> None:
        """A task failed for good: it alone and what waits for it."""
        self.ended[task] = "failed"
        self.tell(TaskFailed(task, why.error, why.details, why.kind.value))
        for dependent in self.dependents[task]:
            self._block(dependent, task)

    def _abandon(self, why: Failure) -> None:
        """No worker can be reached any more: what was in flight failed, or else what comes next, and the rest is
        blocked by it."""
        left = [t for t in self.order if t not in self.ended and self.selection.allows(t.stage)]
        failed = [t for t in left if t in self.flight.flying] or left[:1]
        self.out.clear()
        for task in failed:
            self._fail(task, why)
        for task in self.order:
            self._block(task, failed[0] if failed else task)

    def _release(self, task: Task, how: str) -> None:
        """Let the dependents of a settled task move on."""
        self.ended[task] = how
        for dependent in self.dependents[task]:
            self._wake(dependent, task)

    def _wake(self, task: Task, settled: Task) -> None:
        """A task has one thing less to wait for."""
        if settled in self.waiting[task]:
            self.waiting[task].discard(settled)
            if not self.waiting[task]:
                self._push(task)

    def _call_back(self, task: Task, producers: Sequence[Task]) -> None:
        """A stale task reads what was dropped: have that made again first, or block the task where --only forbids
        it."""
        forbidden = [p for p in producers if not self.selection.allows(p.stage)]
        if forbidden:
            self._block(task, forbidden[0])
            return
        for producer in producers:
            self.plans[task.sequence].book.call_back(producer, task.stage)
            self.waiting[task].add(producer)
            if producer in self.ended:
                self._reopen(producer, task)

    def _reopen(self, task: Task, by: Task) -> None:
        """A settled task may have to run after all: what is not settled behind it waits for it, and it waits for
        readers a worker has in hand."""
        del self.ended[task]
        self.before[task] = self.plans[task.sequence].book.receipts[task]
        self.tell(TaskNeeded(task, by))
        for reader in self.dependents[task]:
            if reader in self.out:
                self.waiting[task].add(reader)
                self.behind[reader].append(task)
            elif reader not in self.ended:
                self.waiting[reader].add(task)
        if not self.waiting[task]:
            self._push(task)

    def _block(self, task: Task, by: Task) -> None:
        """Settle a task that cannot run and everything behind it: left out where --only says so, else blocked."""
        todo = [task]
        while todo:
            t = todo.pop()
            if t in self.ended or t in self.out:
                continue  # what a worker has in hand settles itself
            allowed = self.selection.allows(t.stage)
            self.ended[t] = "blocked" if allowed else "left_out"
            self.tell(TaskBlocked(t, by) if allowed else TaskLeftOut(t))
            todo += self.dependents[t]
