"""What a part of the table is told, and the rows that it gives."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmarks.report import rounded

SMALL = 16
"""Px of whatever is drawn or filmed where figures do not count."""
WARM_UP = 5
UNMEASURED = "not measured here"


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    what: str
    size: str = ""
    """Of what is drawn, filmed or computed."""
    figure: float | str = ""
    """A number where something was measured; a sentence where not."""
    unit: str = ""
    on: str = ""
    """The device that computed."""
    wrong: bool = False
    """Whether it tells of a failure."""

    @property
    def told(self) -> str:
        """As a line, for those who wait for the table."""
        figure = f"{rounded(self.figure):,g} {self.unit}" if isinstance(self.figure, float) else self.figure
        return ", ".join(word for word in (self.what, self.size) if word) + f": {figure}".rstrip()


@dataclass(frozen=True)
class Setup:
    """What all parts are told."""

    device: torch.device
    """A CUDA device, or the CPU: then everything is small and runs once, to see that it runs."""
    repeats: int = 50
    """Of what takes milliseconds."""
    minutes: float = 0.0
    """Of training; 0: none."""
    training: Path = Path("training-gpu")
    """Folder of the training, which goes on where it is."""

    @property
    def small(self) -> bool:
        """Whether figures do not count."""
        return self.device.type != "cuda"

    @property
    def name(self) -> str:
        """Of the device."""
        return "the CPU" if self.small else torch.cuda.get_device_name(self.device)

    def px(self, size: int, small: int = SMALL) -> int:
        """A side of that many px, or `small` ones."""
        return small if self.small else size

    def timed(self, work: Callable[[], Any]) -> tuple[float, float]:
        """(median milliseconds between CUDA events, after warming up; MiB allocated at the peak beyond what was there
        before). On the CPU once, by the clock, and no MiB."""
        if self.small:
            begun = time.perf_counter()
            work()
            return 1000 * (time.perf_counter() - begun), 0.0
        for _ in range(WARM_UP):
            work()
        torch.cuda.synchronize(self.device)
        before = torch.cuda.memory_allocated(self.device)
        torch.cuda.reset_peak_memory_stats(self.device)
        times = []
        for _ in range(self.repeats):
            start, stop = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            start.record()
            work()
            stop.record()
            stop.synchronize()
            times.append(start.elapsed_time(stop))
        return statistics.median(times), (torch.cuda.max_memory_allocated(self.device) - before) / 2**20
