"""Tasks that other runs work on: when their leases are looked at again, and whom this run waits for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.storage.archive.lease import Holder, ended, read_lease, remove_ended
from posegaussian.storage.archive.receipts import lease_file
from posegaussian.storage.archive.store import SequenceGroup

FIRST_PAUSE, LONGEST_PAUSE = 0.05, 2.0
"""Seconds between two looks at the leases: doubled while nothing changes."""

SAID_AGAIN = 300.0
"""Seconds after which the same wait is told once more."""

Priority = tuple[int, int]
"""Smaller goes first."""


@dataclass
class _Held:
    priority: Priority
    order: WorkOrder
    holder: Holder


class HeldTasks:
    """What is waited for; a lease that ended, because its task is done, failed or given up, frees the task for this
    run."""

    def __init__(self, lease: float) -> None:
        """`lease`: seconds a lease holds without renewal."""
        self._lease = lease
        self._tasks: dict[Task, _Held] = {}
        self._pause, self._next = FIRST_PAUSE, 0.0
        self._said: dict[str, float] = {}
        """When a wait was told last, by the run that is waited for."""

    def __len__(self) -> int:
        """Tasks held."""
        return len(self._tasks)

    def add(self, task: Task, priority: Priority, order: WorkOrder, holder: Holder) -> None:
        """Another run works on a task."""
        self._tasks[task] = _Held(priority, order, holder)
        self._look_after(FIRST_PAUSE)

    def _look_after(self, pause: float) -> None:
        self._pause, self._next = pause, time.monotonic() + pause

    @property
    def due(self) -> float:
        """Seconds until the leases are to be looked at."""
        return max(0.0, self._next - time.monotonic())

    def freed(self) -> Iterator[tuple[Priority, Task, WorkOrder]]:
        """Give back the tasks whose leases have ended, if it is time to look."""
        if not self._tasks or self.due:
            return
        before = len(self._tasks)
        for task, held in list(self._tasks.items()):
            file = lease_file(SequenceGroup(held.order.root), held.order.key)
            holder = read_lease(file, self._lease)
            if holder is None or ended(holder, time.time()):
                if holder is not None:
                    remove_ended(file, holder)
                del self._tasks[task]
                yield held.priority, task, held.order
            else:
                held.holder = holder
        self._look_after(FIRST_PAUSE if len(self._tasks) < before else min(2 * self._pause, LONGEST_PAUSE))

    def sentences(self) -> Iterator[str]:
        """Whom this run waits for: each once, and then rarely."""
        now = time.monotonic()
        for run in {h.holder.run for h in self._tasks.values()}:
            if now - self._said.get(run, -SAID_AGAIN) < SAID_AGAIN:
                continue
            self._said[run] = now
            tasks = [t for t, h in self._tasks.items() if h.holder.run == run]
            first, more = tasks[0], len(tasks) - 1
            what = f"{first.sequence} {first.label()}" + (f" and {number(more, 'other task')}" if more else "")
            yield (
                f"waiting for {self._tasks[first].holder.sentence(time.time())}, which works on {what}; what it gives"
                " up is done here"
            )
