"""How long a run still takes: what its tasks are expected to take, corrected by what the finished ones took.

Before the start the expectation comes from the archive's own history (`posegaussian.dags.planning.forecast`), else from
what tasks took on one core of an ordinary machine, which is called a guess wherever it is said.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable, Mapping

from posegaussian.dags.humanize.text import seconds_text
from posegaussian.dags.planning.forecast import History, Loads
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import (
    Event,
    RunStarted,
    TaskBlocked,
    TaskDone,
    TaskFailed,
    TaskFresh,
    TaskLeftOut,
    TaskNeeded,
    TasksChanged,
)
from posegaussian.stages.registry import stage as stage_named

TYPICAL = {
    "survey": 1.2e-7,
    "judge": 5e-7,
    "detection": 3e-7,
    "tracks": 2e-8,
    "people": 1e-10,
    "pose": 1e-7,
    "frames": 1e-6,
    "smoothing": 1e-7,
    "depth": 3.6e-6,
    "network": 1e-6,
    "gaussians": 5e-7,
    "refinement": 6e-6,
    "rendering": 1.9e-6,
    "metrics": 6e-7,
}
"""Seconds of one core per unit of work (frames x views x pixels) by stage, for a guess: rounded from a filmed person
at 512 px, four cameras, five frames, metrics from a small simulated one (`python -m
benchmarks.pipeline.typical_rates ARCHIVE` prints an archive's); network and refinement, which did not run there, are
rough figures of the order of their benchmarks."""

TRUST = 2.0
"""Tasks that have to be done before what they took weighs as much as what was expected of their stage."""

SLOWEST = 0.25
"""Workers that are taken to be busy at least: while the first tasks start, hardly any work is done yet."""

LEAST = 0.1
"""Share of the time left that stays until the next task is done, however long that takes."""


class Remaining:
    """A listener that knows how much of a run is done and how long the rest takes."""

    def __init__(self, expected: Mapping[Task, float], workers: int, guessed: bool = False) -> None:
        """`expected` seconds of every task that may run; `guessed`: some of them from no history."""
        self.expected, self.workers, self.guessed = expected, max(1, workers), guessed
        self._open: dict[Task, float] = {}
        self._left: dict[str, float] = defaultdict(float)
        self._took: dict[str, tuple[float, float, int]] = {}
        """By stage: (seconds expected, seconds taken, number) of the tasks that ran."""
        self._start: float | None = None
        self._heard: float | None = None
        """When a task was settled last."""

    @classmethod
    def of(cls, plans: Iterable[Plan], history: History, workers: int) -> Remaining:
        """What the tasks of some plans that a run may have to compute are expected to take."""
        expected: dict[Task, float] = {}
        guessed = False
        for plan in plans:
            loads, rates = Loads(plan.context), {}
            for task in plan.to_make:
                if task.stage not in rates:
                    rates[task.stage] = history.rate(
                        stage_named(task.stage), plan.context.params(stage_named(task.stage))
                    ).seconds
                rate = rates[task.stage]
                guessed = guessed or rate is None
                expected[task] = loads(task).work * (TYPICAL[task.stage] if rate is None else rate)
        return cls(expected, workers, guessed)

    @property
    def seconds_before(self) -> float:
        """Seconds the whole run is expected to take, before it starts: no less than its longest task."""
        return max(sum(self.expected.values()) / self.workers, *self.expected.values(), 0.0)

    @property
    def sentence(self) -> str:
        """How long the run is expected to take."""
        told = f"expected to take about {seconds_text(self.seconds_before)}"
        return f"{told}, a guess: work of this kind was not done in this archive yet" if self.guessed else told

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, RunStarted):
            self._start = self._heard = time.monotonic()
            self._open = {t: self.expected.get(t, 0.0) for t in event.tasks}
            for task, seconds in self._open.items():
                self._left[task.stage] += seconds
        elif isinstance(event, TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut):
            self._settle(event.task, event.receipt.facts.get("seconds") if isinstance(event, TaskDone) else None)
        elif isinstance(event, TasksChanged):
            alike = {(t.stage, t.partition): self.expected.get(t, 0.0) for t in event.gone}
            come = {t: alike.get((t.stage, t.partition), 0.0) for t in event.come}
            self.expected = {**self.expected, **come}
            for task in event.gone:
                self._settle(task, None)
            self._open |= come
            for task, seconds in come.items():
                self._left[task.stage] += seconds
        elif isinstance(event, TaskNeeded):
            self._open[event.task] = self.expected.get(event.task, 0.0)
            self._left[event.task.stage] += self._open[event.task]

    def _settle(self, task: Task, seconds: float | None) -> None:
        self._heard = time.monotonic()
        expected = self._open.pop(task, 0.0)
        self._left[task.stage] -= expected
        if seconds is None:
            return  # nothing was done for it: the rest is what there is to do
        was, took, number = self._took.get(task.stage, (0.0, 0.0, 0))
        self._took[task.stage] = (was + expected, took + seconds, number + 1)

    def _factor(self, stage: str) -> float:
        """Seconds taken over seconds expected, pulled towards 1 while few tasks are done."""
        expected, took, number = self._took.get(stage, (0.0, 0.0, 0))
        if not number or expected <= 0:
            return 1.0
        return float((took / expected) ** (number / (number + TRUST)))

    @property
    def work_left(self) -> float:
        """Seconds of one worker."""
        return sum(max(0.0, left) * self._factor(stage) for stage, left in self._left.items())

    @property
    def share_done(self) -> float:
        """0 to 1: how much of the work is done."""
        whole = self._work_done + self.work_left
        return self._work_done / whole if whole > 0 else 0.0

    @property
    def seconds_left(self) -> float:
        """Seconds until the end, at the pace of the run so far;
        they run down while tasks are in hand, but not to nothing."""
        if self._start is None or self._heard is None:
            return self.work_left / self.workers
        passed = self._heard - self._start
        pace = self._work_done / passed if self._work_done and passed > 0 else float(self.workers)
        then = self.work_left / min(max(pace, SLOWEST), float(self.workers))
        return max(then - (time.monotonic() - self._heard), LEAST * then)

    @property
    def _work_done(self) -> float:
        return sum(took for _, took, _ in self._took.values())
