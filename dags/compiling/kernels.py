"""Processes that need the same compiled kernel at the same time: one compiles it, the others wait and load it.

numba keeps compiled kernels in a folder, but lets every process that does not find one there compile it: on a first
run all workers compile the same. A lock lies beside each kernel's files; the system drops it when its holder dies.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from posegaussian.dags.compiling.warm_up import warming_up


@cache
def compile_once() -> None:
    """Have this process wait for others that compile what it needs; for good."""
    from numba.core.dispatcher import Dispatcher

    alone, held = Dispatcher.compile, set[Path]()

    def together(kernel: Any, signature: Any) -> Any:
        with warming_up(), _locked(_lock_of(kernel), held):
            return alone(kernel, signature)

    setattr(Dispatcher, "compile", together)  # noqa: B010 - numba has no place for it, and its types forbid it


def _lock_of(kernel: Any) -> Path | None:
    """The lock beside a kernel's files; None of one that is not kept."""
    folder = kernel._cache.cache_path
    return Path(folder) / f"{kernel._cache._impl.filename_base}.lock" if folder else None


@contextmanager
def _locked(lock: Path | None, held: set[Path]) -> Iterator[None]:
    """Within, no other process has the lock, which is added to those `held`; nothing is locked where there is none,
    twice, or in a folder that cannot be written. Kernels call each other in no circle, so that nobody waits for ever.
    """
    if lock is None or lock in held:
        yield
        return
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        file = lock.open("a")
    except OSError:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        held.add(lock)
        try:
            yield
        finally:
            held.remove(lock)
