"""The back end without a cluster: one task at a time, in this process."""

from __future__ import annotations

from posegaussian.dags.planning.resources import CPU, Pool, machine_memory
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.failures import Failure, failure
from posegaussian.dags.runtime.work_order import Order
from posegaussian.dags.runtime.worker import execute
from posegaussian.storage.archive.receipts import Receipt


class SerialBackend:
    """`posegaussian.dags.runtime.in_flight.Backend` in this process."""

    def __init__(self, ram: int | None = None) -> None:
        """One slot. `ram`: bytes this process may take; None: all there is."""
        self._ram = ram
        self.sentences: tuple[str, ...] = ("running serially in this process, one task at a time",)
        self._next: tuple[Task, Order] | None = None

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

    def submit(self, task: Task, order: Order) -> None:
        """Keep the task for `next_done`."""
        self._next = (task, order)

    def news(self) -> list[str]:
        """None: nobody joins or leaves."""
        return []

    def next_done(self, seconds: float | None = None) -> tuple[Task, Receipt | Failure] | None:
        """Run the task in hand, to its end."""
        assert self._next is not None
        (task, order), self._next = self._next, None
        try:
            return task, execute(order)
        except Exception as e:
            return task, failure(e)

    def close(self, hard: bool = False) -> None:
        """Nothing to give back."""

    def kill(self) -> None:
        """Nothing outlives this process."""
