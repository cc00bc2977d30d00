"""The run loop: judge tasks as their inputs become known, hand the stale ones to a back end, let failures fail alone."""

from __future__ import annotations

import heapq
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from dags.events import Event, Listener, RunEnded, RunStarted, TaskBlocked, TaskDone, TaskFailed, TaskFresh, TaskLeftOut, TaskStarted
from dags.execute import Order
from dags.orders import make_order, prepare
from dags.plan import Book, Plan, Selection, State, judge
from dags.tasks import Task, dependencies
from stages.registry import STAGES
from storage.receipts import Receipt, damaged_files, remove_receipt

DEPTH = {s.name: i for i, s in enumerate(STAGES)}
"""Position of a stage in the flow; deeper work goes first, so that finished pictures appear early."""


@dataclass(frozen=True)
class Failure:
    """A task that raised."""

    error: str
    """One sentence."""
    details: str
    """Traceback, or empty for errors the user can mend."""
    corrupt: bool = False
    """Whether it read a shard that is missing or damaged."""


class Backend(Protocol):
    """Where tasks run: in this process, or on a cluster."""

    sentences: tuple[str, ...]
    """What the user should know about it."""

    def free(self, gpu: bool) -> int:
        """How many more tasks the pool takes now."""

    def submit(self, task: Task, order: Order) -> None:
        """Hand over one task."""

    def next_done(self) -> tuple[Task, Receipt | Failure]:
        """Wait for any task in flight."""

    def close(self) -> None:
        """Stop what is in flight and give the workers back."""


class Run:
    """One run over some sequences."""

    def __init__(self, plans: Sequence[Plan], selection: Selection, backend: Backend, listeners: Iterable[Listener], threads: int = 1) -> None:
        """Nothing is touched before `go`."""
        self.plans = {p.context.sequence.name: p for p in plans}
        self.selection, self.backend, self.listeners, self.threads = selection, backend, tuple(listeners), threads
        self.order = {task: i for i, task in enumerate(t for p in plans for t in p.verdicts)}
        self.waiting: dict[Task, int] = {}
        self.dependents: dict[Task, list[Task]] = defaultdict(list)
        self.ready: list[tuple[int, int, Task]] = []
        self.queued: dict[bool, list[tuple[int, int, Task, Order, tuple[str, ...]]]] = {False: [], True: []}
        self.reasons: dict[Task, tuple[str, ...]] = {}
        self.ended: set[Task] = set()
        self.counts: dict[str, int] = dict.fromkeys(("done", "fresh", "failed", "blocked", "left_out"), 0)

    def tell(self, event: Event) -> None:
        """Give an event to every listener."""
        for listener in self.listeners:
            listener(event)

    def go(self) -> RunEnded:
        """Run to the end; a keyboard interrupt stops handing out tasks and ends the run."""
        start, interrupted = time.perf_counter(), False
        self.tell(RunStarted(tuple(self.order), self.backend.sentences))
        try:
            for plan in self.plans.values():
                prepare(plan)
                plan.book = Book.open(plan.context)
            self._link()
            self._loop()
        except KeyboardInterrupt:
            interrupted = True
        finally:
            self.backend.close()
        ended = RunEnded(**self.counts, seconds=time.perf_counter() - start, interrupted=interrupted)
        self.tell(ended)
        return ended

    def _link(self) -> None:
        """Count what every task waits for."""
        for plan in self.plans.values():
            for task in plan.verdicts:
                before = [d for d in dependencies(plan.context, task) if d in self.order]
                self.waiting[task] = len(before)
                for d in before:
                    self.dependents[d].append(task)
                if not before:
                    self._push(task)

    def _push(self, task: Task) -> None:
        heapq.heappush(self.ready, (-DEPTH[task.stage], self.order[task], task))

    def _loop(self) -> None:
        in_flight = 0
        while True:
            while self.ready:
                self._judge(heapq.heappop(self.ready)[2])
            in_flight += self._hand_out()
            if not in_flight:
                return
            task, result = self.backend.next_done()
            in_flight -= 1
            self._settle(task, result)

    def _judge(self, task: Task) -> None:
        """A task whose inputs are settled: fresh, or queued for a worker."""
        plan = self.plans[task.sequence]
        digests = plan.book.digests(task)
        assert digests is not None, f"{task.label()} became ready before its inputs"
        state, why, parts = judge(plan.book, task, self.selection, digests)
        if state is State.FRESH:
            self.counts["fresh"] += 1
            self.tell(TaskFresh(task))
            self._release(task)
        elif not self.selection.allows(task.stage):
            self._block(task, task)
        else:
            order = make_order(plan.context, plan.book, task, parts, self.threads)
            self.reasons[task] = why
            heapq.heappush(self.queued[order.gpu], (-DEPTH[task.stage], self.order[task], task, order, why))

    def _hand_out(self) -> int:
        """Fill the window of every pool; returns how many tasks went out."""
        sent = 0
        for gpu, queue in self.queued.items():
            while queue and self.backend.free(gpu) > 0:
                _, _, task, order, _ = heapq.heappop(queue)
                self.tell(TaskStarted(task))
                self.backend.submit(task, order)
                sent += 1
        return sent

    def _settle(self, task: Task, result: Receipt | Failure) -> None:
        if isinstance(result, Failure):
            self.counts["failed"] += 1
            self.ended.add(task)
            if result.corrupt:
                self._distrust(task)
            self.tell(TaskFailed(task, result.error, result.details))
            for dependent in self.dependents[task]:
                self._block(dependent, task)
            return
        self.counts["done"] += 1
        self.plans[task.sequence].book.add(task, result)
        self.tell(TaskDone(task, result, self.reasons.pop(task)))
        self._release(task)

    def _distrust(self, task: Task) -> None:
        """Take back the receipts of damaged shards that a task reads, so that the next run makes them anew."""
        plan = self.plans[task.sequence]
        for d in dependencies(plan.context, task):
            receipt = plan.book.receipts.get(d)
            if receipt is not None and damaged_files(plan.context.sequence, receipt):
                remove_receipt(plan.context.sequence, *d[1:])

    def _release(self, task: Task) -> None:
        """Let the dependents of a settled task move on."""
        self.ended.add(task)
        for dependent in self.dependents[task]:
            self.waiting[dependent] -= 1
            if not self.waiting[dependent] and dependent not in self.ended:
                self._push(dependent)

    def _block(self, task: Task, by: Task) -> None:
        """Settle a task that cannot run and everything behind it: left out where --only says so, else blocked."""
        todo = [task]
        while todo:
            t = todo.pop()
            if t in self.ended:
                continue
            self.ended.add(t)
            allowed = self.selection.allows(t.stage)
            self.counts["blocked" if allowed else "left_out"] += 1
            self.tell(TaskBlocked(t, by) if allowed else TaskLeftOut(t))
            todo += self.dependents[t]
