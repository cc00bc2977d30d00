"""How far ahead of its work a worker is given tasks."""

from __future__ import annotations

from collections import deque
from math import ceil

MOST = 8
"""Tasks in flight for a worker at most, unless the setting asks for more: all of them are tried again when it is
killed."""
AHEAD = 0.05
"""Seconds of work that should wait on a worker: orders and results reach it in batches 5 to 10 ms apart, at both
ends."""
RECENT = 16
"""Tasks whose mean length counts."""


class Window:
    """Tasks in flight for each worker of a pool: few while tasks are long, more while they are shorter than their
    way to the worker."""

    def __init__(self, least: int) -> None:
        """`least`: tasks in flight however long they take (`run.window`)."""
        self.least = least
        self._recent: deque[float] = deque(maxlen=RECENT)

    def note(self, seconds: float) -> None:
        """A task took so long on its worker."""
        self._recent.append(seconds)

    @property
    def tasks(self) -> int:
        """Tasks a worker may be given now."""
        if len(self._recent) < RECENT:
            return self.least
        mean = sum(self._recent) / RECENT
        return max(self.least, min(MOST, ceil(AHEAD / max(mean, 1e-6))))
