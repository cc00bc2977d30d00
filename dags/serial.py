"""The back end without a cluster: one task at a time, in this process."""

from __future__ import annotations

import traceback

from dags.execute import Order, execute
from dags.run import Failure
from dags.tasks import Task
from storage.errors import ShardCorrupt, ShardMissing, UserError
from storage.receipts import Receipt


def failure(error: BaseException) -> Failure:
    """One sentence of an error; with the traceback unless the user can mend it."""
    if isinstance(error, UserError):
        return Failure(str(error), "", corrupt=isinstance(error, ShardCorrupt | ShardMissing))
    sentence = f"{type(error).__name__}: {error}"
    return Failure(sentence, "".join(traceback.format_exception(error)))


class SerialBackend:
    """`dags.run.Backend` in this process."""

    def __init__(self) -> None:
        """One slot."""
        self.sentences: tuple[str, ...] = ("running serially in this process, one task at a time",)
        self._next: tuple[Task, Order] | None = None

    def free(self, gpu: bool) -> int:
        """One, while nothing is in hand."""
        return 0 if self._next else 1

    def submit(self, task: Task, order: Order) -> None:
        """Keep the task for `next_done`."""
        self._next = (task, order)

    def next_done(self) -> tuple[Task, Receipt | Failure]:
        """Run the task in hand."""
        assert self._next is not None
        (task, order), self._next = self._next, None
        try:
            return task, execute(order)
        except Exception as e:
            return task, failure(e)

    def close(self) -> None:
        """Nothing to give back."""
