"""Processes that a test has go wrong: a kernel that never comes back, a child that ends before it begins."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection


def _in_python() -> None:
    """Hear every exception, and go on."""
    while True:
        try:
            time.sleep(1)
        except BaseException:
            continue


def _in_numba() -> None:
    """A compiled loop that holds nothing."""
    from numba import njit

    @njit(nogil=True)
    def for_ever(x: float) -> float:
        while x > 0.0:
            x = x * 0.5 + 1.0
        return x

    for_ever(1.0)


def _with_the_interpreter() -> None:
    """One C call that does not let go of the interpreter: no other thread of the process runs any more."""
    ctypes.PyDLL(None).pause()


def stick(how: Callable[[], None] = _in_python) -> None:
    """Have the kernel of gaussians never come back from partition 1, once it has written its first block."""
    import posegaussian.stages.gaussians.run as gaussians

    real = gaussians.run

    def run(inputs: object, params: object) -> object:
        blocks = real(inputs, params)  # type: ignore[arg-type]
        if inputs.partition.start == 2:  # type: ignore[attr-defined]
            yield next(blocks)
            how()
        yield from blocks

    gaussians.run = run  # type: ignore[assignment]


def stuck_in_numba(connection: Connection) -> None:
    """In place of `posegaussian.dags.runtime.executors.child.serve`, as those below."""
    _serve(connection, _in_numba)


def stuck_with_the_interpreter(connection: Connection) -> None:
    _serve(connection, _with_the_interpreter)


def dead_on_arrival(connection: Connection) -> None:
    os._exit(3)


def _serve(connection: Connection, how: Callable[[], None]) -> None:
    from posegaussian.dags.runtime.executors.child import serve

    stick(how)
    serve(connection)
