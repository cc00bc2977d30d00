"""A child process that computes one task after another, for the serial back end: it can be ended in the middle of a
task.

It is started with the first task and anew with the next one after it died, so that imports and compiled kernels are
paid once. `concurrent.futures` has such processes, too, but they would outlive a parent that is killed.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from posegaussian.dags.provenance import builds
from posegaussian.dags.runtime import threads
from posegaussian.dags.runtime.executors.dask_worker import Introduction, introduce
from posegaussian.dags.runtime.failures import Failure, failure
from posegaussian.dags.runtime.signals import deaf
from posegaussian.dags.runtime.timeout import death
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.dags.runtime.worker import execute
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.model.errors import OtherCode

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess


def attempt(order: WorkOrder) -> Receipt | Failure:
    """One attempt at a task in this process."""
    try:
        return execute(order)
    except Exception as e:
        return failure(e)


class Child:
    """A process that attempts tasks; there is none before the first one."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None

    def attempt(self, order: WorkOrder) -> Receipt | Failure:
        """One attempt at a task there; what its end means, where the process ends over it.

        Raises OtherCode when files were edited since this process began, so that the child has imported others.
        """
        try:
            connection = self._connection or self._start()
            connection.send(order)
            result: Receipt | Failure = connection.recv()
        except (EOFError, OSError):
            self.close()
            return death(order)
        return result

    def _start(self) -> Connection:
        context = multiprocessing.get_context("spawn")  # torch runs threads here: a fork could not be trusted
        os.environ.update(threads.allocator())
        ours, theirs = context.Pipe()
        self._connection, self._process = ours, context.Process(target=serve, args=(theirs,), name="tasks", daemon=True)
        with deaf():
            self._process.start()
        theirs.close()
        self._meet(ours.recv())
        return ours

    def _meet(self, child: Introduction | OtherCode) -> None:
        """Let go of a child that is not of this build. Raises OtherCode."""
        if isinstance(child, Introduction):
            if child.digest == builds.here().digest:
                return
            child = OtherCode(builds.objection(f"process {child.pid} on {child.host}", child.versions, builds.EDITED))
        self.close()
        raise child

    def kill(self) -> None:
        """End the process without waiting for it; any thread may do so."""
        if (process := self._process) is not None and process.pid is not None:
            process.kill()

    def close(self) -> None:
        """End the process, whatever it computes."""
        self.kill()
        if self._process is not None and self._process.pid is not None:
            self._process.join()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = None


def serve(connection: Connection) -> None:
    """The life of the child: it says who it is, then makes one attempt after another until its parent is gone."""
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    with suppress(EOFError, OSError):
        connection.send(_introduction())
        while True:
            connection.send(attempt(connection.recv()))


def _introduction() -> Introduction | OtherCode:
    try:
        return introduce(None)
    except OtherCode as e:
        return e


def _end_with_parent() -> None:
    """End this process in the middle of its task when its parent was killed: the task's lease ends with it."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
