"""Running one plan for commands that look at what comes of it: in this process, task by task, or on workers that stay
for the next one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.in_flight import Backend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.signals import interruptible
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.model.errors import UserError


class RunFailed(UserError):
    """A task failed; its traceback, where it is no error of the user, is a note of this one."""


def run_here(
    plan: Plan,
    selection: Selection,
    threads: int = 1,
    after_each: Callable[[], None] | None = None,
    workers: Backend | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[Task, Receipt]:
    """Run what is not fresh; the receipts of what ran.

    `after_each` is called after every task; what it raises ends the run, what is done is kept. `workers`: what runs it
    in place of this process, left open but for an interrupt. `say`: takes the sentence shown at a Ctrl-C; None: whoever
    calls is `interruptible`, or says nothing before the task in hand has heard.

    Raises:
        RunFailed: with a sentence for every task that failed, when all others are done.
        KeyboardInterrupt: after Ctrl-C; what is done is kept.
    """
    done: dict[Task, Receipt] = {}
    failed: list[TaskFailed] = []

    def note(event: Event) -> None:
        if isinstance(event, TaskFailed):
            failed.append(event)
        elif isinstance(event, TaskDone):
            done[event.task] = event.receipt
            if after_each is not None:
                after_each()

    backend = workers or SerialBackend()
    with interruptible(say, backend.kill) if say is not None else nullcontext():
        ended = Run([plan], selection, backend, [note], threads, more=workers is not None).go()
    if ended.interrupted:
        raise KeyboardInterrupt
    if failed:
        error = RunFailed("; ".join(f"{f.task.label()}: {f.error.strip()}" for f in failed))
        for f in failed:
            if f.details:
                error.add_note(f.details)
        raise error
    return done
