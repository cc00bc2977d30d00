"""What a plan says and what happens in a run, as data: one stream of typed events.

Progress, the run log (and from it the ledger) and machines that read `--json` subscribe; the runner prints nothing
itself.
`record` is the one JSON form of an event; docs/reference/ledger.md documents it field by field.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, get_args

from posegaussian.dags.planning.tasks import Task
from posegaussian.storage.archive.receipts import Receipt


@dataclass(frozen=True)
class TaskPlanned:
    """A plan's verdict on one task."""

    task: Task
    state: str
    """fresh, stale or undecided."""
    reasons: tuple[str, ...]
    """Why it is not fresh."""


@dataclass(frozen=True)
class StageUnneeded:
    """A stage that a capture does not need."""

    sequence: str
    stage: str
    reason: str


@dataclass(frozen=True)
class EffectPlanned:
    """What is known of one effect of a sequence."""

    sequence: str
    effect: str
    setting: str
    """auto, on or off."""
    state: str
    """on, off, or undecided until the survey ran."""
    measured: float | None
    """In `unit`; None where it is not known."""
    bound: float
    unit: str
    reason: str


@dataclass(frozen=True)
class SequenceRefused:
    """A sequence that cannot be planned under its settings; the others go on."""

    sequence: str
    error: str
    """The sentence of the error."""


@dataclass(frozen=True)
class RunStarted:
    """A run begins."""

    tasks: tuple[Task, ...]
    """All tasks it may come to, in the order of flow."""
    sentences: tuple[str, ...]
    """What the user should know before it starts, for example where GPU work goes."""


@dataclass(frozen=True)
class EffectsDecided:
    """The survey of a sequence is through: what waited for its measures is decided."""

    sequence: str
    sentences: tuple[str, ...]
    """One an effect: on or off, and why."""
    on: tuple[str, ...] = ()
    """Names of those that are on."""
    off: tuple[str, ...] = ()
    """Names of those that are off."""


@dataclass(frozen=True)
class TasksChanged:
    """The cameras that are believed were decided, and camera paths with them: other tasks than the run started with."""

    gone: tuple[Task, ...]
    """Tasks that it does not come to any more."""
    come: tuple[Task, ...]
    """Tasks that it comes to besides."""


@dataclass(frozen=True)
class TaskStarted:
    """A task was handed to a worker."""

    task: Task


@dataclass(frozen=True)
class TaskFresh:
    """A task need not run."""

    task: Task


@dataclass(frozen=True)
class TaskNeeded:
    """A task that was settled runs after all: its output was dropped and is needed, or what it read came out
    different."""

    task: Task
    by: Task
    """The task that needs it made again, or whose content changed."""


@dataclass(frozen=True)
class TaskDone:
    """A task ran; its receipt is on disk."""

    task: Task
    receipt: Receipt
    reasons: tuple[str, ...]
    """Why it ran."""


@dataclass(frozen=True)
class TaskFailed:
    """A task raised; the others go on."""

    task: Task
    error: str
    """The sentence of the error."""
    details: str
    """Traceback for the log; empty for errors the user can mend."""
    kind: str = "deterministic"
    """Class of the failure, a value of `posegaussian.dags.runtime.failures.Kind`."""


@dataclass(frozen=True)
class TaskRetried:
    """An attempt failed and another one follows."""

    task: Task
    error: str
    """The sentence of the error."""
    kind: str
    """Class of the failure, a value of `posegaussian.dags.runtime.failures.Kind`."""
    pause: float
    """Seconds until the next attempt."""


@dataclass(frozen=True)
class TaskBlocked:
    """A task cannot run because one before it failed or was left out by --only."""

    task: Task
    by: Task
    """The task it waits for."""


@dataclass(frozen=True)
class TaskLeftOut:
    """A stale task of a stage that --only leaves out."""

    task: Task


@dataclass(frozen=True)
class Notice:
    """Something to know while a run goes: whom it waits for, or a worker that is given nothing."""

    sentence: str


@dataclass(frozen=True)
class RunEnded:
    """A run is over."""

    done: int
    fresh: int
    failed: int
    blocked: int
    left_out: int
    seconds: float
    interrupted: bool
    """Whether the user stopped it."""
    taken: int = 0
    """Fresh tasks whose results were taken over from an earlier run with these settings."""


Event = (
    TaskPlanned
    | StageUnneeded
    | EffectPlanned
    | SequenceRefused
    | RunStarted
    | EffectsDecided
    | TasksChanged
    | TaskStarted
    | TaskFresh
    | TaskNeeded
    | TaskDone
    | TaskRetried
    | TaskFailed
    | TaskBlocked
    | TaskLeftOut
    | Notice
    | RunEnded
)
Listener = Callable[[Event], None]

FACTS = ("started", "seconds", "cpu_seconds", "host", "worker", "device", "peak_rss", "modules")
"""Facts of a receipt that go into the record of a finished task."""


@cache
def event_name(kind: type) -> str:
    """`TaskDone` -> `task_done`, as written to JSON."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def event_kinds() -> dict[str, type]:
    """{name in JSON: class} of all events."""
    return {event_name(k): k for k in get_args(Event)}


def record(event: Event) -> dict[str, Any]:
    """One event as plain JSON types: `event` is its name; a task is spread over sequence, stage, partition, view and
    path.

    The tasks of a run are counted by stage; of a receipt the fingerprint, bytes, warnings and FACTS are kept.
    """
    kind: type = type(event)
    out: dict[str, Any] = {"event": event_name(kind)}
    for f in fields(event):
        out |= _plain(f.name, getattr(event, f.name))
    return out


def _plain(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, Task):
        return value._asdict() if name == "task" else {name: value._asdict()}
    if isinstance(value, Receipt):
        size = sum(f.size for o in value.outputs for f in o.files)
        return {
            "fingerprint": value.fingerprint,
            "bytes": size,
            "warnings": list(value.warnings),
            **{k: value.facts.get(k) for k in FACTS},
        }
    if name == "tasks":
        return {"tasks": len(value), "stages": dict(Counter(t.stage for t in value))}
    if name in ("gone", "come"):
        return {name: len(value)}
    return {name: dict(value) if isinstance(value, Mapping) else list(value) if isinstance(value, tuple) else value}
