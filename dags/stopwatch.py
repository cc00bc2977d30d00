"""Seconds by module of a task, taken while its kernel runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Called with a module's name it is a context that measures that module.

    A module begun within another one stops the outer one's clock meanwhile, so the sum is never more than the time that passed.
    """

    def __init__(self) -> None:
        """Nothing measured yet."""
        self.seconds: dict[str, float] = {}
        """By module, in the order in which they came first to an end."""
        self._running: list[str] = []
        self._since = 0.0

    @contextmanager
    def __call__(self, module: str) -> Iterator[None]:
        """Measure what is done within, whether or not it raises."""
        self._charge()
        self._running.append(module)
        try:
            yield
        finally:
            self._charge()
            self._running.pop()

    def _charge(self) -> None:
        """Give the innermost module the seconds since the last change."""
        now = time.perf_counter()
        if self._running:
            module = self._running[-1]
            self.seconds[module] = self.seconds.get(module, 0.0) + now - self._since
        self._since = now
