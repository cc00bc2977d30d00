"""Time limit of one task: an exception in its thread, and the end of the worker's process if that is not heard."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from posegaussian.dags.runtime.failures import TaskTimedOut

GRACE = 5.0
"""Seconds from the exception to the end of the process: a kernel inside one long C call hears the exception only
after it."""


def worker_name() -> str:
    """Name of the Dask worker this thread works for; `main` outside of one."""
    worker = _worker()
    return "main" if worker is None else str(worker.name)


def _worker() -> Any:
    distributed = sys.modules.get("distributed")  # a task of a Dask worker finds it imported
    if distributed is None:
        return None
    try:
        return distributed.get_worker()
    except ValueError:
        return None


@contextmanager
def time_limit(seconds: float | None, last_words: Callable[[str], None]) -> Iterator[None]:
    """Raise TaskTimedOut in this thread after `seconds`; None: never.

    In a Dask worker, a thread that does not hear it for GRACE seconds takes its process along, after `last_words` was
    given the reason; the nanny starts a new one. In the driver's own process the exception waits for the C call to end.
    """
    if seconds is None:
        yield
        return
    watch = _Watch(seconds, last_words if _worker() is not None else None)
    try:
        yield
    except TaskTimedOut:
        raise TaskTimedOut(watch.why) from None  # the interpreter raised the bare class
    finally:
        watch.stop()


class _Watch:
    def __init__(self, seconds: float, last_words: Callable[[str], None] | None) -> None:
        self._thread = threading.get_ident()
        self.why = f"it took longer than {seconds:g} s (run.timeout)"
        self._last_words = last_words
        self._fired = False
        self._over = False
        self._guard = threading.Lock()
        self._timer = self._start(seconds, self._raise)

    def _start(self, seconds: float, then: Callable[[], None]) -> threading.Timer:
        timer = threading.Timer(seconds, then)
        timer.daemon = True
        timer.start()
        return timer

    def _raise(self) -> None:
        with self._guard:
            if self._over:
                return
            self._fired = True
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), ctypes.py_object(TaskTimedOut))
            if self._last_words is not None:
                self._timer = self._start(GRACE, self._die)

    def _die(self) -> None:
        with self._guard:
            if self._over:
                return
            assert self._last_words is not None
            self._last_words(self.why)
            os._exit(1)

    def stop(self) -> None:
        """The task is over: an exception that was not heard yet is withdrawn."""
        with self._guard:
            self._over = True
            self._timer.cancel()
            if self._fired:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), None)
