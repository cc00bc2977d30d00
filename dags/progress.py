"""Progress: bars and estimates on a terminal, plain lines where there is none, one JSON object a line for machines."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from dags.events import EffectsDecided, Event, Notice, RunEnded, RunStarted, TaskBlocked, TaskDone, TaskFailed, TaskFresh, TaskLeftOut, TaskNeeded
from dags.history import stamped
from dags.tasks import Task
from dags.wording import number
from stages.registry import STAGES

QUIET_SECONDS = 10.0
"""Pause between two plain progress lines."""


class TerminalProgress:
    """Bars of rich, one a stage that has something to do."""

    def __init__(self, console: Console) -> None:
        """Nothing is shown before the run starts."""
        self.console = console
        self.bars = Progress(TextColumn("{task.description:<11}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console)
        self.ids: dict[str, TaskID] = {}

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, RunStarted):
            for sentence in event.sentences:
                self.console.print(sentence, markup=False, soft_wrap=True)
            total = Counter(t.stage for t in event.tasks)
            self.ids = {s.name: self.bars.add_task(s.name, total=total[s.name], start=False) for s in STAGES if total[s.name]}
            self.bars.start()
        elif isinstance(event, TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut):
            bar = self.ids[event.task.stage]
            self.bars.start_task(bar)
            self.bars.advance(bar)
            if isinstance(event, TaskFailed):
                self.bars.console.print(f"failed: {event.task.sequence} {event.task.label()}: {event.error}", markup=False, style="red")
        elif isinstance(event, EffectsDecided):
            for sentence in event.sentences:
                self.bars.console.print(f"{event.sequence}: {sentence}", markup=False, soft_wrap=True)
        elif isinstance(event, Notice):
            self.bars.console.print(event.sentence, markup=False, soft_wrap=True, style="yellow")
        elif isinstance(event, TaskNeeded):
            self.bars.advance(self.ids[event.task.stage], -1)
        elif isinstance(event, RunEnded):
            self.bars.stop()


class PlainProgress:
    """A line now and then, for logs and pipes."""

    def __init__(self, write: Callable[[str], None] = print) -> None:
        """`write` takes one line."""
        self.write = write
        self.total: Counter[str] = Counter()
        self.settled: Counter[str] = Counter()
        self.ran: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.first: dict[str, float] = {}
        self.last = time.monotonic()

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, RunStarted):
            for sentence in event.sentences:
                self.write(sentence)
            self.total = Counter(t.stage for t in event.tasks)
        elif isinstance(event, TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut):
            self._settle(event)
        elif isinstance(event, EffectsDecided):
            for sentence in event.sentences:
                self.write(f"{event.sequence}: {sentence}")
        elif isinstance(event, Notice):
            self.write(event.sentence)
        elif isinstance(event, TaskNeeded):
            self.settled[event.task.stage] -= 1

    def _settle(self, event: TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut) -> None:
        stage, now = event.task.stage, time.monotonic()
        self.settled[stage] += 1
        if isinstance(event, TaskDone):
            self.ran[stage] += 1
            self.first.setdefault(stage, now - event.receipt.facts.get("seconds", 0.0))
        if isinstance(event, TaskFailed):
            self.write(f"failed: {event.task.sequence} {event.task.label()}: {event.error}")
        if not isinstance(event, TaskDone | TaskFresh):
            self.lost[stage] += 1
        if self.settled[stage] == self.total[stage] and self.ran[stage]:
            lost = f", {self.lost[stage]} failed, blocked or left out" if self.lost[stage] else ""
            self.write(f"{stage}: {self.total[stage] - self.lost[stage]} of {self.total[stage]} done{lost}, {now - self.first[stage]:.1f} s")
            self.last = now
        elif now - self.last > QUIET_SECONDS:
            lines = [self._line(s, now) for s in self.total if 0 < self.settled[s] < self.total[s]]
            if lines:
                self.write("; ".join(lines))
            self.last = now

    def _line(self, stage: str, now: float) -> str:
        left = ""
        if self.ran[stage]:
            left = f", about {(now - self.first[stage]) / self.ran[stage] * (self.total[stage] - self.settled[stage]):.0f} s left"
        return f"{stage} {self.settled[stage]}/{self.total[stage]}{left}"


class JsonLines:
    """Every event as one JSON object a line on standard output, for machines."""

    def __call__(self, event: Event) -> None:
        """Take one event; the line is out before the next thing happens."""
        print(stamped(event), flush=True)


class WarningCollector:
    """The warnings of checks and the failures of a run, for the end of the run and for its log."""

    def __init__(self) -> None:
        """Empty."""
        self.warnings: list[str] = []
        self.failures: list[TaskFailed] = []
        self.blocked: dict[tuple[Task, str], list[Task]] = defaultdict(list)
        """By what they wait for, and why that is not done."""

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, TaskDone):
            self.warnings += [f"{event.task.sequence} {event.task.label()}: {w}" for w in event.receipt.warnings]
        elif isinstance(event, TaskFailed):
            self.failures.append(event)
        elif isinstance(event, TaskBlocked):
            why = "failed" if any(f.task == event.by for f in self.failures) else "is stale and left out by --only"
            self.blocked[event.by, why].append(event.task)

    def blocked_sentences(self, cameras: Mapping[str, tuple[str, ...]]) -> list[str]:
        """One sentence for everything that others wait for; `cameras` names the views of each sequence."""
        found = []
        for (by, why), tasks in self.blocked.items():
            stages = ", ".join(dict.fromkeys(t.stage for t in tasks))
            found.append(f"blocked: {by.sequence}: {number(len(tasks), 'task')} of {stages}: {by.label(cameras.get(by.sequence, ()))} {why}")
        return found
