"""By the clock: how long the tasks of a run take when workers share them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from posegaussian.dags.planning.tasks import Task

SHARED = 0.9
"""What one of several workers does in the time in which one alone does 1."""


@dataclass
class Tasks:
    """Seconds of a sequence's tasks, each done alone."""

    by_view: list[float] = field(default_factory=list)
    """Of the whole sequence, a task a view; they come first, in any order."""
    whole: float = 0.0
    """Of the whole sequence, one after the other, then."""
    partitions: dict[int, float] = field(default_factory=dict)
    """{partition: of its tasks together, one after the other}; partitions come last, in their order."""

    def add(self, task: Task, seconds: float) -> None:
        """One more task."""
        if task.partition is not None:
            self.partitions[task.partition] = self.partitions.get(task.partition, 0.0) + seconds
        elif task.view is not None:
            self.by_view.append(seconds)
        else:
            self.whole += seconds


def clock(sequences: Sequence[Tasks], workers: int) -> float:
    """Seconds until the last task is done, each job on the worker that is free first: several sequences are begun
    together, and workers do what nothing earlier of its sequence is missing for."""
    free = [0.0] * workers
    jobs = max((len(s.by_view) for s in sequences), default=0), sum(len(s.partitions) for s in sequences)
    slower = [1 / SHARED if min(workers, n) > 1 else 1.0 for n in jobs]

    def done(seconds: float, begin: float) -> float:
        """When a job is done that can begin then."""
        worker = free.index(min(free))
        free[worker] = max(free[worker], begin) + seconds
        return free[worker]

    ready = []
    for s in sequences:
        looked = max([done(slower[0] * took, 0.0) for took in s.by_view], default=0.0)
        ready.append(done(s.whole, looked) if s.whole else looked)
    for s, begin in zip(sequences, ready, strict=True):
        for partition in sorted(s.partitions):
            done(slower[1] * s.partitions[partition], begin)
    return max(free)
