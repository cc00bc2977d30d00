"""Time limit of one task: the process that computes it ends itself and says so in the task's lease; who waited reads it
there.

A kernel in a C call that never comes back hears no exception, and while it holds the interpreter no Python runs beside
it. The limit is therefore kept by the thread of `faulthandler`, which needs no interpreter: it writes where every
thread is, and ends the process. A Dask worker is started anew by its nanny, the serial back end's child by its parent.
"""

from __future__ import annotations

import faulthandler
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from posegaussian.dags.runtime.failures import Failure, Kind, TaskTimedOut, failure
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.storage.archive.lease import Holder, Lease, read_lease
from posegaussian.storage.archive.receipts import lease_file
from posegaussian.storage.archive.store import SequenceGroup

AT_ONCE = 1e-3
"""Seconds, more than none, after which a limit ends that is over when it is armed."""


@contextmanager
def time_limit(seconds: float | None, lease: Lease) -> Iterator[None]:
    """End this process after `seconds` with last words in the lease of the task, unless the block ends before; None:
    never."""
    if seconds is None:
        yield
        return
    _LIMITS.add(lease, seconds)
    try:
        yield
    finally:
        _LIMITS.remove(lease)


class _Limits:
    """The limits of the tasks in this process: workers of others may have several threads. The earliest one is
    armed."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._ends: dict[Lease, float] = {}

    def add(self, lease: Lease, seconds: float) -> None:
        with self._guard:
            self._ends[lease] = time.monotonic() + seconds
            self._arm()

    def remove(self, lease: Lease) -> None:
        with self._guard:
            del self._ends[lease]
            self._arm()

    def _arm(self) -> None:
        faulthandler.cancel_dump_traceback_later()
        if self._ends:
            lease, end = min(self._ends.items(), key=lambda entry: entry[1])
            faulthandler.dump_traceback_later(max(end - time.monotonic(), AT_ONCE), exit=True, file=lease.last_words())


_LIMITS = _Limits()


def overran(order: WorkOrder) -> TaskTimedOut | None:
    """The error of a task whose limit ended its process in this very run; None where that has not happened."""
    if order.terms.timeout is None or (holder := _holder(order)) is None or not holder.ended:
        return None
    error = TaskTimedOut(f"it took longer than {order.terms.timeout:g} s (run.timeout)")
    error.add_note(f"where its process {holder.pid} on {holder.host} was then:\n{holder.ended}")
    return error


def death(order: WorkOrder) -> Failure:
    """What the end of the process that had a task means for it, from the task's lease."""
    holder = _holder(order)
    if holder is None:
        return Failure("the worker it waited on died", kind=Kind.SPARED)
    if error := overran(order):
        return failure(error)
    return Failure(f"its worker {holder.worker} died: killed for memory, or crashed", kind=Kind.MEMORY)


def _holder(order: WorkOrder) -> Holder | None:
    """Who of this run holds the lease of a task, or left it behind."""
    holder = read_lease(lease_file(SequenceGroup(order.root), order.key), order.terms.lease)
    return holder if holder is not None and holder.run == order.terms.run else None
