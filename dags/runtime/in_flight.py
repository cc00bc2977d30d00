"""Tasks between the plan and their end: queued for a pool, in a worker's hand, waiting for a second attempt.

Every pool of workers has a window of its own, because a resource tag switches off Dask's back-pressure: without the
window one task killed for memory takes all tasks parked on its worker along.
"""

from __future__ import annotations

import heapq
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from posegaussian.dags.planning.resources import Pool
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import Event, Notice, TaskRetried, TaskStarted
from posegaussian.dags.runtime.failures import Failure, Kind, with_advice
from posegaussian.dags.runtime.leases import HeldTasks, Priority
from posegaussian.dags.runtime.work_order import RunTerms, WorkOrder
from posegaussian.storage.archive.lease import own_name
from posegaussian.storage.archive.receipts import Receipt

MOST_SPARED = 3
"""Deaths of its worker before its start after which a task is no longer thought innocent."""

LONGEST_PAUSE = 300.0
"""Seconds between two attempts at most."""


class Backend(Protocol):
    """Where tasks run: in this process, or on a cluster."""

    sentences: tuple[str, ...]
    """What the user should know about it."""

    @property
    def pools(self) -> Mapping[str, Pool]:
        """What its workers can serve, by name."""

    def pool(self, gpu: int) -> str:
        """Name of the pool that serves tasks asking for so many GPUs."""

    def free(self, pool: str) -> int:
        """How many more tasks a pool takes now."""

    def submit(self, task: Task, order: WorkOrder) -> None:
        """Hand over one task."""

    def next_done(self, seconds: float | None = None) -> tuple[Task, Receipt | Failure] | None:
        """Wait for any task in flight, at most so long; None: none ended."""

    def news(self) -> list[str]:
        """What the user should know, since it was last asked for."""

    def close(self, hard: bool = False) -> None:
        """Give the workers back; hard: without waiting for what they compute."""

    def kill(self) -> None:
        """End at once what would outlive this process; called from any thread."""


def _terms() -> RunTerms:
    return RunTerms(run=own_name("unnamed"))


@dataclass(frozen=True)
class Rules:
    """How a run treats what fails, and what it tells its workers."""

    terms: RunTerms = field(default_factory=_terms)
    """Name of the run, time of a lease, time limit of a task."""
    retries: int = 2
    """Further attempts after a transient failure."""
    backoff: float = 5.0
    """Seconds before the second attempt; doubled before each further one."""


@dataclass(frozen=True)
class _Flying:
    order: WorkOrder
    priority: Priority
    pool: str


class Flight:
    """Hands tasks out, takes them back, and tries again what deserves it."""

    def __init__(self, backend: Backend, rules: Rules, tell: Callable[[Event], None]) -> None:
        """Nothing is handed out before `next`."""
        self.backend, self.rules, self.tell = backend, rules, tell
        self.queued: dict[str, list[tuple[Priority, Task, WorkOrder]]] = defaultdict(list)
        self.flying: dict[Task, _Flying] = {}
        self.delayed: list[tuple[float, Priority, Task, WorkOrder]] = []
        self.suspects: dict[str, list[tuple[Priority, Task, WorkOrder]]] = defaultdict(list)
        """Tasks that killed a worker, by pool: each runs once more with nothing beside it in its pool."""
        self.alone: dict[str, Task] = {}
        """The suspect that has a pool to itself now."""
        self.tried_alone: set[Task] = set()
        self.held = HeldTasks(rules.terms.lease)
        self.attempts: Counter[Task] = Counter()
        self.spared: Counter[Task] = Counter()

    def add(self, priority: Priority, task: Task, order: WorkOrder) -> None:
        """Queue a task for its pool."""
        for counted in (self.attempts, self.spared):
            counted.pop(task, None)
        self._queue(priority, task, replace(order, terms=self.rules.terms))

    def _queue(self, priority: Priority, task: Task, order: WorkOrder) -> None:
        heapq.heappush(self.queued[self.backend.pool(order.gpu)], (priority, task, order))

    def next(self) -> tuple[Task, Receipt | Failure] | None:
        """The next task that ended for good; None when nothing is queued, flying or waiting any more."""
        while True:
            while self.delayed and self.delayed[0][0] <= time.monotonic():
                self._queue(*heapq.heappop(self.delayed)[1:])
            for freed in self.held.freed():
                self._queue(*freed)
            self._hand_out()
            if self.flying or any(self.queued.values()) or any(self.suspects.values()):
                done = self.backend.next_done(self._until_due())
                self._notice(self.backend.news())
                if done is not None and (final := self._take_back(*done)) is not None:
                    return final
            elif (until := self._until_due()) is not None:
                self._notice(self.held.sentences())
                time.sleep(until)
            else:
                return None

    def _notice(self, sentences: Iterable[str]) -> None:
        for sentence in sentences:
            self.tell(Notice(sentence))

    def _until_due(self) -> float | None:
        """Seconds until something waits no longer; None when nothing waits."""
        waits = [
            *([max(0.0, self.delayed[0][0] - time.monotonic())] if self.delayed else []),
            *([self.held.due] if self.held else []),
        ]
        return min(waits, default=None)

    def _hand_out(self) -> None:
        """Fill the window of every pool; a pool with a suspect empties first, and then is the suspect's alone."""
        for pool in {*self.queued, *self.suspects}:
            if pool in self.alone:
                continue
            if self.suspects[pool]:
                if not any(f.pool == pool for f in self.flying.values()):
                    self.alone[pool] = self._send(pool, heapq.heappop(self.suspects[pool]))
                continue
            while self.queued[pool] and self.backend.free(pool) > 0:
                self._send(pool, heapq.heappop(self.queued[pool]))

    def _send(self, pool: str, item: tuple[Priority, Task, WorkOrder]) -> Task:
        priority, task, order = item
        self.flying[task] = _Flying(order, priority, pool)
        self.attempts[task] += 1
        self.tell(TaskStarted(task))
        self.backend.submit(task, order)
        return task

    def _take_back(self, task: Task, result: Receipt | Failure) -> tuple[Task, Receipt | Failure] | None:
        """Settle what came back, or keep it for another attempt (None)."""
        flown = self.flying.pop(task)
        if self.alone.get(flown.pool) == task:
            del self.alone[flown.pool]
        if isinstance(result, Receipt):
            return task, result
        if result.kind is Kind.SPARED:
            self.attempts[task] -= 1
            self.spared[task] += 1
            result = result if self.spared[task] <= MOST_SPARED else replace(result, kind=Kind.MEMORY)
        attempts = self.attempts[task]
        if result.kind is Kind.SPARED:
            self._queue(flown.priority, task, flown.order)
        elif result.kind is Kind.HELD:
            self.held.add(task, flown.priority, flown.order, result.holder)
        elif result.kind is Kind.MEMORY and task not in self.tried_alone:
            self.tried_alone.add(task)
            heapq.heappush(self.suspects[flown.pool], (flown.priority, task, flown.order))
            self.tell(TaskRetried(task, result.error, result.kind.value, 0.0))
        elif result.kind in (Kind.TRANSIENT, Kind.LOST) and attempts <= self.rules.retries:
            pause = (
                min(self.rules.backoff * 2 ** (attempts - 1), LONGEST_PAUSE) if result.kind is Kind.TRANSIENT else 0.0
            )
            heapq.heappush(self.delayed, (time.monotonic() + pause, flown.priority, task, flown.order))
            self.tell(TaskRetried(task, result.error, result.kind.value, pause))
        else:
            return task, with_advice(result, attempts)
        return None
