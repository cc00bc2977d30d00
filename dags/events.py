"""What happens in a run, as data. Progress, history and reports subscribe; the runner prints nothing itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dags.tasks import Task
from storage.receipts import Receipt


@dataclass(frozen=True)
class RunStarted:
    """A run begins."""

    tasks: tuple[Task, ...]
    """All tasks it may come to, in the order of flow."""
    sentences: tuple[str, ...]
    """What the user should know before it starts, for example where GPU work goes."""


@dataclass(frozen=True)
class TaskStarted:
    """A task was handed to a worker."""

    task: Task


@dataclass(frozen=True)
class TaskFresh:
    """A task need not run."""

    task: Task


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


Event = RunStarted | TaskStarted | TaskFresh | TaskDone | TaskFailed | TaskBlocked | TaskLeftOut | RunEnded
Listener = Callable[[Event], None]
