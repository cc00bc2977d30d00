"""The back end without a cluster: one task at a time, in this process, or in a child of it where a task has a time
limit."""

from __future__ import annotations

from posegaussian.dags.planning.resources import CPU, Pool, machine_memory
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.executors.child import Child, attempt
from posegaussian.dags.runtime.failures import Failure
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.storage.archive.receipts import Receipt


class SerialBackend:
    """`posegaussian.dags.runtime.in_flight.Backend` in this process and its child."""

    def __init__(self, ram: int | None = None) -> None:
        """One slot. `ram`: bytes this process may take; None: all there is."""
        self._ram = ram
        self.sentences: tuple[str, ...] = ("running serially, one task at a time",)
        self._next: tuple[Task, WorkOrder] | None = None
        self._child = Child()

    @property
    def pools(self) -> dict[str, Pool]:
        """This process alone."""
        return {CPU: Pool(1, 0, self._ram or machine_memory())}

    def pool(self, gpu: int) -> str:
        """This process serves everything."""
        return CPU

    def free(self, pool: str) -> int:
        """One, while nothing is in hand."""
        return 0 if self._next else 1

    def submit(self, task: Task, order: WorkOrder) -> None:
        """Keep the task for `next_done`."""
        self._next = (task, order)

    def news(self) -> list[str]:
        """None: nobody joins or leaves."""
        return []

    def next_done(self, seconds: float | None = None) -> tuple[Task, Receipt | Failure] | None:
        """Run the task in hand, to its end or to that of its time. Raises OtherCode when files were edited before
        its process began."""
        assert self._next is not None
        (task, order), self._next = self._next, None
        return task, attempt(order) if order.terms.timeout is None else self._child.attempt(order)

    def close(self, hard: bool = False) -> None:
        """End the child; after an interrupt in the middle of its task."""
        self._child.close()

    def kill(self) -> None:
        """End the child in the middle of its task; the task's lease ends with it."""
        self._child.kill()
