"""What a task took while its kernel ran: peak memory of its process, seconds by module."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

import psutil

SAMPLE_SECONDS = 0.02
"""Pause between two looks at the process, where the kernel's own record of the peak cannot be reset."""

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")


class Peak:
    """Peak resident memory of this process while a block runs, bytes, in `bytes` afterwards.

    The process's own record of its peak is cumulative, so a small task after a large one would be charged with the
    large one's. On Linux the record is reset at the start (proc(5), clear_refs 5) and is exact; elsewhere a thread
    samples.
    """

    def __init__(self) -> None:
        """Measures nothing yet."""
        self.bytes = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Peak:
        """Begin."""
        try:
            CLEAR.write_text("5")
        except OSError:
            self._thread = threading.Thread(target=self._sample, name="memory-peak", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""
        if self._thread is None:
            self.bytes = next(
                int(line.split()[1]) * 1024 for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:")
            )
            return
        self._stop.set()
        self._thread.join()
        self._look()

    def _look(self) -> None:
        self.bytes = max(self.bytes, psutil.Process().memory_info().rss)

    def _sample(self) -> None:
        while not self._stop.wait(SAMPLE_SECONDS):
            self._look()


class Stopwatch:
    """Called with a module's name it is a context that measures that module.

    A module begun within another one stops the outer one's clock meanwhile, so the sum is never more than the time that
    passed.
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
