"""Memory of a task: what its process took at most, measured."""

from __future__ import annotations

import threading
from pathlib import Path
from types import TracebackType

import psutil

SAMPLE_SECONDS = 0.02
"""Pause between two looks at the process, where the kernel's own record of the peak cannot be reset."""

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")


class Peak:
    """Peak resident memory of this process while a block runs, bytes, in `bytes` afterwards.

    The process's own record of its peak is cumulative, so a small task after a large one would be charged with the large
    one's. On Linux the record is reset at the start (proc(5), clear_refs 5) and is exact; elsewhere a thread samples.
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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End."""
        if self._thread is None:
            self.bytes = next(int(line.split()[1]) * 1024 for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
            return
        self._stop.set()
        self._thread.join()
        self._look()

    def _look(self) -> None:
        self.bytes = max(self.bytes, psutil.Process().memory_info().rss)

    def _sample(self) -> None:
        while not self._stop.wait(SAMPLE_SECONDS):
            self._look()
