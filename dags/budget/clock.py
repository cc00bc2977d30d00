"""By the clock: how long the tasks of a run take when workers share them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from posegaussian.dags.planning.tasks import Task


@dataclass
class Tasks:
    """Seconds of a sequence's tasks, measured while as many others run as will."""

    by_view: list[float] = field(default_factory=list)
    """Of the whole sequence, a task a view; they come first."""
    whole: float = 0.0
    """Of the whole sequence, one after the other; taken to be done before any partition, though `tracks` waits for
    some."""
    partitions: dict[int, float] = field(default_factory=dict)
    """{partition: of its tasks together, one after the other, though views and paths of one may be shared}; they come
    last, in their order."""

    def add(self, task: Task, seconds: float) -> None:
        """One more task."""
        if task.partition is not None:
            self.partitions[task.partition] = self.partitions.get(task.partition, 0.0) + seconds
        elif task.view is not None:
            self.by_view.append(seconds)
        else:
            self.whole += seconds


def clock(sequences: Sequence[Tasks], workers: int) -> float:
    """Seconds until the last task is done. The worker that is free first takes the job that can begin first: views of a
    sequence, when all are done what is asked of the whole of it, then its partitions."""
    phases = [[list(s.by_view), [s.whole], [s.partitions[p] for p in sorted(s.partitions)]] for s in sequences]
    free, begin, end = [0.0] * workers, [0.0] * len(phases), [0.0] * len(phases)
    phase = [0] * len(phases)
    while True:
        for i, of in enumerate(phases):
            while phase[i] < 3 and not of[phase[i]]:
                phase[i], begin[i] = phase[i] + 1, end[i]
        left = [i for i in range(len(phases)) if phase[i] < 3]
        if not left:
            return max(free)
        worker = free.index(min(free))
        i = min(left, key=lambda i: max(begin[i], free[worker]))
        free[worker] = max(begin[i], free[worker]) + phases[i][phase[i]].pop(0)
        end[i] = max(end[i], free[worker])
