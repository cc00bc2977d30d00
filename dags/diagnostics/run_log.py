"""What runs did: their log in the archive while they go, and what is still failed after the last ones."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics.status import Planner
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import (
    EffectPlanned,
    Event,
    RunEnded,
    SequenceRefused,
    StageUnneeded,
    TaskFailed,
    TaskFresh,
    TaskPlanned,
    event_name,
    record,
)
from posegaussian.storage.archive.ledger import EVENTS, KEY, RUNS, run_events
from posegaussian.storage.archive.receipts import ReceiptKey, read_receipt
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.files.write import refusals
from posegaussian.storage.model.errors import ConfigError, NotWritten, UserError

SETTINGS = "pipeline.yaml"
"""File of a run's effective settings, beside its events."""


def stamped(event: Event) -> str:
    """One line of JSON: the event's record and the time it was told, UTC."""
    return json.dumps({"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **record(event)}, sort_keys=False)


class RunLog:
    """Appends every event of a run to `_runs/<start>/events.jsonl`; what was fresh is counted by the last line alone.

    Lines are written as things happen, so the log of a run that was killed says how far it came. What the disk does not
    take is kept and tried again with the next event: a log must not end the run that it is about.
    """

    def __init__(self, folder: Path) -> None:
        """The folder of the run; the file is made by the first event."""
        self.file = folder / EVENTS
        self._open: IO[bytes] | None = None
        self._left = b""
        """Told, and not on disk yet."""
        self._why = ""

    def __call__(self, event: Event) -> None:
        """Take one event of the run."""
        if isinstance(event, TaskFresh):
            return
        self._left += f"{stamped(event)}\n".encode()
        try:
            with refusals(self.file):
                self._write()
        except NotWritten as e:
            self._why = str(e)
        if isinstance(event, RunEnded) and self._open is not None:
            self._open.close()
            self._open = None

    def _write(self) -> None:
        if self._open is None:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self._open = open(self.file, "ab", buffering=0)  # noqa: SIM115  closed when the run ends
        while self._left:
            self._left = self._left[self._open.write(self._left) :]

    @property
    def sentences(self) -> list[str]:
        """What the user should know after the run: whether the log lacks events."""
        lost = self._left.count(b"\n")
        if not lost:
            return []
        sentence = (
            f"the log of this run lacks its last {number(lost, 'event')}, so `status --failed` and the ledger do"
            f" not know of them: {self._why}"
        )
        return [sentence]


@dataclass(frozen=True)
class FailedTask:
    """A task that failed, was not finished since, and is still to be made."""

    task: Task
    error: str
    """The sentence of its last failure."""
    when: str
    """UTC, ISO 8601."""
    run: str
    """Name of the run below `_runs`."""
    blocked: int = 0
    """Tasks that could not run because of it."""


def still_failed(planner: Planner, names: Iterable[str]) -> list[FailedTask]:
    """What failed in the sequences' last runs, has no newer receipt, and would have to be made under the planner's
    settings, newest first: going back to settings whose results are there leaves nothing to retry."""
    archive, wanted = planner.archive, set(names)
    last: dict[Task, FailedTask] = {}
    for run, events in run_events(archive):
        for e in events:
            name = e.get("event")
            if name == "task_blocked":
                by = Task(**e["by"])
                if by in last and last[by].run == run:
                    last[by] = FailedTask(**{**vars(last[by]), "blocked": last[by].blocked + 1})
            elif name in ("task_done", event_name(TaskFailed)):
                task = Task(*(e[k] for k in KEY))
                last.pop(task, None)
                if name != "task_done" and task.sequence in wanted:
                    last[task] = FailedTask(task, str(e["error"]), str(e["time"]), run)
    failed = [f for f in last.values() if not _finished_since(archive, f)]
    return sorted(_to_make(planner, failed), key=lambda f: f.when, reverse=True)


def _finished_since(archive: Archive, failed: FailedTask) -> bool:
    """Whether the task has a receipt newer than its failure, from a run whose log is gone."""
    t = failed.task
    receipt = read_receipt(archive.sequence(t.sequence), ReceiptKey(*t[1:]))
    return receipt is not None and str(receipt.facts.get("started", "")) > failed.when


def _to_make(planner: Planner, failed: Iterable[FailedTask]) -> Iterator[FailedTask]:
    """Those of some failures that a plan has and does not hold fresh, along the camera paths of the run in which they
    failed; all of a sequence that cannot be planned."""
    open_tasks: dict[tuple[str, tuple[str, ...]], frozenset[Task] | None] = {}
    for f in failed:
        key = f.task.sequence, _paths_asked_for(planner.archive, f)
        if key not in open_tasks:
            open_tasks[key] = _open_tasks(planner, *key)
        todo = open_tasks[key]
        if todo is None or f.task in todo:
            yield f


def _open_tasks(planner: Planner, name: str, paths: tuple[str, ...]) -> frozenset[Task] | None:
    """Needed tasks of a sequence that are not fresh; None where it cannot be planned."""
    try:
        plan = planner.plan(name, Selection(), paths)
    except UserError:
        return None
    return frozenset(t for t, v in plan.verdicts.items() if v.state is not State.FRESH and t.stage not in plan.unneeded)


def _paths_asked_for(archive: Archive, failed: FailedTask) -> tuple[str, ...]:
    """Camera paths of the run in which a task failed, as they were asked for; () for the configured ones."""
    file = archive.place(f"{RUNS}/{failed.run}/{SETTINGS}")
    if failed.task.path is None or not file.is_file():
        return ()
    try:
        return tuple(load_configuration(file).for_sequence(failed.task.sequence).rendering.paths or ())
    except ConfigError:  # of another version of the program
        return ()


def retry_command(archive: Archive, sequences: Iterable[str], run: str | None = None) -> str:
    """The command that does what failed; with the settings of a run where they were kept."""
    words = ["posegaussian", "run", "--archive", str(archive.root)]
    settings = archive.place(f"{RUNS}/{run}/{SETTINGS}") if run else None
    words += ["--config", str(settings)] if settings and settings.is_file() else []
    for name in dict.fromkeys(sequences):
        words += ["--sequence", name]
    return shlex.join(words)


def failed_table(failed: Iterable[FailedTask]) -> Table:
    """One row a failed task."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in ("sequence", "task", "when (UTC)", "blocks", "why"):
        table.add_column(column, justify="right" if column == "blocks" else "left", overflow="fold")
    for f in failed:
        table.add_row(
            escape(f.task.sequence),
            f.task.label(),
            f.when[5:16].replace("T", " "),
            str(f.blocked or ""),
            escape(f.error),
        )
    return table


def retries(archive: Archive, failed: Iterable[FailedTask]) -> list[str]:
    """One command a run that left failures, newest first."""
    by_run: dict[str, list[str]] = {}
    for f in failed:
        by_run.setdefault(f.run, []).append(f.task.sequence)
    return [f"retry with: {retry_command(archive, sequences, run)}" for run, sequences in by_run.items()]


def report_failed(planner: Planner, names: Iterable[str], console: Console) -> int:
    """Print what is still failed and how to retry it; returns the exit status, 1 where there is anything."""
    failed = still_failed(planner, names)
    if not failed:
        console.print("nothing failed that was not finished since", markup=False)
        return 0
    console.print(failed_table(failed))
    for line in retries(planner.archive, failed):
        console.print(line, markup=False, soft_wrap=True)
    return 1


def tell_plans(plans: Iterable[Plan], refused: Iterable[str]) -> None:
    """Write plans as JSON lines: a verdict a task, a line a stage that is not needed,
    a line a sequence that cannot be planned."""
    for sentence in refused:
        name, _, error = sentence.partition(": ")
        print(stamped(SequenceRefused(name, error)))
    for plan in plans:
        for stage, reason in plan.unneeded.items():
            print(stamped(StageUnneeded(plan.context.sequence.name, stage, reason)))
        for e in plan.context.effects.values():
            d = e.decision
            print(
                stamped(
                    EffectPlanned(
                        plan.context.sequence.name,
                        e.effect.name,
                        e.setting,
                        e.state,
                        d.measured if d else None,
                        e.effect.threshold,
                        e.effect.unit,
                        d.reason if d else "known once it was measured",
                    )
                )
            )
        for v in plan.verdicts.values():
            print(stamped(TaskPlanned(v.task, v.state.value, v.reasons)))
