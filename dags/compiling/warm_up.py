"""What a process spends once: importing libraries, compiling kernels, loading kept ones, waiting for who compiles them.

It falls on whichever task comes first and says nothing about that task, so it is timed apart.
"""

from __future__ import annotations

import builtins
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any, TypeAlias

WARM_UP = "warm_up"
"""The module of a task, and the fact of its receipt, that these seconds are."""
Timed: TypeAlias = Callable[[str], AbstractContextManager[None]]
"""Measures what is done within as a module's."""


def steady_seconds(facts: Mapping[str, Any]) -> float:
    """Wall seconds of a task by the facts of its receipt, without its process's warming up where that was timed."""
    return float(facts.get("seconds") or 0.0) - float(facts.get(WARM_UP) or 0.0)


class _Meter:
    """Seconds in which any thread of this process warms up."""

    def __init__(self) -> None:
        """Nobody to tell."""
        self.timed: Timed | None = None
        self._lock, self._inside, self._open = threading.Lock(), 0, ExitStack()

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """Within, one more does: kernels compile those that they call, libraries import others."""
        with self._lock:
            self._inside += 1
            if self._inside == 1 and self.timed is not None:
                self._open.enter_context(self.timed(WARM_UP))
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if not self._inside:
                    self._open.close()


warming_up = _Meter()
"""What is done within is warming up."""


@contextmanager
def warm_up_timed(timed: Timed) -> Iterator[None]:
    """Within, this process's warming up is `timed` as `WARM_UP`, that of kernels once `compile_once` was called."""
    plain = builtins.__import__

    def importing(name: str, *where: Any, **more: Any) -> Any:
        if name in sys.modules:
            return plain(name, *where, **more)
        with warming_up():
            return plain(name, *where, **more)

    warming_up.timed = timed
    builtins.__import__ = importing  # kernels import libraries where they need them
    try:
        yield
    finally:
        builtins.__import__, warming_up.timed = plain, None
