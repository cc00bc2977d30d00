"""Progress: one bar and one estimate on a terminal, plain lines where there is none,
one JSON object a line for machines."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Task as BarTask
from rich.text import Text

from posegaussian.dags.diagnostics.remaining_time import Remaining
from posegaussian.dags.diagnostics.run_log import stamped
from posegaussian.dags.humanize.text import Voice, next_command, number, seconds_text
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import (
    EffectsDecided,
    Event,
    Notice,
    RunEnded,
    RunStarted,
    TaskBlocked,
    TaskDone,
    TaskFailed,
    TaskFresh,
    TaskLeftOut,
    TaskNeeded,
    TasksChanged,
    TaskStarted,
)
from posegaussian.stages.registry import STAGES

QUIET_SECONDS = 10.0
"""Pause between two plain progress lines."""


class TerminalProgress:
    """One bar of rich for the whole run, with one estimate of the time left; what the workers do stands beside it."""

    def __init__(
        self, console: Console, remaining: Remaining, voice: Voice = Voice.NORMAL, options: Sequence[str] = ()
    ) -> None:
        """Nothing is shown before the run starts. `remaining` hears every event before this listener does; `options`
        lead another command to the same archive and settings."""
        self.console, self.remaining, self.voice, self.options = console, remaining, voice, options
        columns = (BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeElapsedColumn(), _Left(remaining))
        self.bars = Progress(*columns, TextColumn("{task.description}", markup=False), console=console)
        self.bar: TaskID | None = None
        self.tally = Tally()

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        self.tally(event)
        for line in _told(event, self.voice, self.options):
            self.bars.console.print(
                line, markup=False, soft_wrap=True, style="red" if isinstance(event, TaskFailed) else None
            )
        if isinstance(event, RunStarted):
            self.bar = self.bars.add_task("", total=1.0)
            self.bars.start()
        elif isinstance(event, RunEnded):
            self._show()
            self.bars.stop()
        elif isinstance(
            event, TaskStarted | TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut | TaskNeeded
        ):
            self._show()

    def _show(self) -> None:
        if self.bar is not None:
            over = self.tally.settled == self.tally.total
            self.bars.update(self.bar, completed=1.0 if over else self.remaining.share_done, description=self.tally.now)


class _Left(ProgressColumn):
    """The time left, looked up whenever the bar is drawn."""

    def __init__(self, remaining: Remaining) -> None:
        super().__init__()
        self.remaining = remaining

    def render(self, task: BarTask) -> Text:
        """Nothing once all is done."""
        return Text("" if task.finished else f"about {seconds_text(self.remaining.seconds_left)} left")


class PlainProgress:
    """A line now and then, for logs and pipes: what each stage did when it is through, and how far all is."""

    def __init__(
        self,
        write: Callable[[str], None],
        remaining: Remaining,
        voice: Voice = Voice.NORMAL,
        options: Sequence[str] = (),
    ) -> None:
        """`write` takes one line; `remaining` hears every event before this listener does; `options` lead another
        command to the same archive and settings."""
        self.write, self.remaining, self.voice, self.options = write, remaining, voice, options
        self.tally = Tally()
        self.first: dict[str, float] = {}
        self.last = time.monotonic()

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        self.tally(event)
        for line in _told(event, self.voice, self.options):
            self.write(line)
        if isinstance(event, TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut):
            self._settled(event)

    def _settled(self, event: TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut) -> None:
        stage, now, tally = event.task.stage, time.monotonic(), self.tally
        if isinstance(event, TaskDone):
            self.first.setdefault(stage, now - event.receipt.facts.get("seconds", 0.0))
        if tally.through(stage) and stage in self.first:
            lost = f", {tally.lost[stage]} failed, blocked or left out" if tally.lost[stage] else ""
            self.write(
                f"{stage}: {tally.totals[stage] - tally.lost[stage]} of {tally.totals[stage]} done{lost},"
                f" {now - self.first[stage]:.1f} s"
            )
            self.last = now
        elif now - self.last > QUIET_SECONDS and tally.now:
            self.write(
                f"{self.remaining.share_done:.0%} done,"
                f" about {seconds_text(self.remaining.seconds_left)} left; {tally.now}"
            )
            self.last = now


def _told(event: Event, voice: Voice, options: Sequence[str]) -> Iterator[str]:
    """The lines that an event is worth; commands in them carry the options."""
    if isinstance(event, RunStarted):
        yield from event.sentences
    elif isinstance(event, TaskFailed):
        yield f"failed: {event.task.sequence} {event.task.label()}: {event.error}"
    elif isinstance(event, Notice):
        yield event.sentence
    elif isinstance(event, EffectsDecided) and voice >= Voice.VERBOSE:
        yield from (f"{event.sequence}: {sentence}" for sentence in event.sentences)
    elif isinstance(event, EffectsDecided) and (event.on or event.off):
        on = ", ".join(event.on) or "none"
        yield (
            f"{event.sequence}: effects switched on by what the frames show: {on}; off:"
            f" {', '.join(event.off) or 'none'} ({next_command('plan', '-v', *options, lead='why')})"
        )


class Tally:
    """How many tasks of each stage are settled, and which stages are at work."""

    def __init__(self) -> None:
        """Before the run starts there is nothing to count."""
        self.totals: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.in_hand: set[Task] = set()

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, RunStarted):
            self.totals = Counter(t.stage for t in event.tasks)
        elif isinstance(event, TasksChanged):
            self.totals += Counter(t.stage for t in event.come)
            self.totals -= Counter(t.stage for t in event.gone)
        elif isinstance(event, TaskStarted):
            self.in_hand.add(event.task)
        elif isinstance(event, TaskDone | TaskFresh | TaskFailed | TaskBlocked | TaskLeftOut):
            self.in_hand.discard(event.task)
            self.counts[event.task.stage] += 1
            self.lost[event.task.stage] += not isinstance(event, TaskDone | TaskFresh)
        elif isinstance(event, TaskNeeded):
            self.counts[event.task.stage] -= 1

    def through(self, stage: str) -> bool:
        """Whether every task of a stage is settled."""
        return self.counts[stage] == self.totals[stage]

    @property
    def total(self) -> int:
        """Tasks of the run."""
        return self.totals.total()

    @property
    def settled(self) -> int:
        """Tasks that are done, fresh, failed, blocked or left out."""
        return self.counts.total()

    @property
    def now(self) -> str:
        """`depth 3/12, rendering 0/12`: stages of which a worker has a task in hand."""
        at_work = {t.stage for t in self.in_hand}
        begun = [s.name for s in STAGES if s.name in at_work]
        return ", ".join(f"{s} {self.counts[s]}/{self.totals[s]}" for s in begun)


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
        self._alike: dict[tuple[Task, str], list[str]] = defaultdict(list)
        """What tasks say that differ in their view alone, and by which cameras' names they said it."""
        self.failures: list[TaskFailed] = []
        self.blocked: dict[tuple[Task, str], list[Task]] = defaultdict(list)
        """By what they wait for, and why that is not done."""

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, TaskDone):
            for warning in event.receipt.warnings:
                self.warnings.append(f"{event.task.sequence} {event.task.label()}: {warning}")
                camera, colon, said = warning.partition(": ")
                if event.task.view is None or not colon:
                    camera, said = "", warning
                self._alike[event.task._replace(view=None), said].append(camera)
        elif isinstance(event, TaskFailed):
            self.failures.append(event)
        elif isinstance(event, TaskBlocked):
            left = f"is stale and left out by --only: add --only {event.by.stage}"
            why = "failed" if any(f.task == event.by for f in self.failures) else left
            self.blocked[event.by, why].append(event.task)

    def warning_sentences(self) -> list[str]:
        """The warnings; what is said of several views alike is said once."""
        found = []
        for (task, said), cameras in self._alike.items():
            names = list(dict.fromkeys(c for c in cameras if c))
            more = f" and {number(len(names) - 1, 'more camera')}" if len(names) > 1 else ""
            about = f"{names[0]}{more}: " if names else ""
            found += [f"{task.sequence} {task.label()}: {about}{said}"] * (1 if names else len(cameras))
        return found

    def blocked_sentences(self, cameras: Mapping[str, tuple[str, ...]]) -> list[str]:
        """One sentence for everything that others wait for; `cameras` names the views of each sequence."""
        found = []
        for (by, why), tasks in self.blocked.items():
            stages = ", ".join(dict.fromkeys(t.stage for t in tasks))
            found.append(
                f"blocked: {by.sequence}: {number(len(tasks), 'task')} of {stages}:"
                f" {by.label(cameras.get(by.sequence, ()))} {why}"
            )
        return found
