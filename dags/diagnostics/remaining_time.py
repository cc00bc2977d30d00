"""How long a run still takes: what its tasks are expected to take, corrected by what the finished ones took.

Before the start the expectation comes from `posegaussian.dags.planning.forecast`: the archive's own history, else a
guess.
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
            stages = {name: stage_named(name) for name in dict.fromkeys(t.stage for t in plan.to_make)}
            rates = {name: history.rate(stage, plan.context.params(stage)) for name, stage in stages.items()}
            loads = Loads(plan.context)
            expected |= {t: loads(t).work * rates[t.stage].seconds for t in plan.to_make}
            guessed = guessed or any(rate.timed == "guess" for rate in rates.values())
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
