"""What kind of failure a task met, and therefore what is done about it."""

from __future__ import annotations

import errno
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from posegaussian.storage.model.errors import (
    LeaseHeld,
    LeaseLost,
    NotWritten,
    OtherCode,
    SchedulerLost,
    ShardCorrupt,
    ShardMissing,
    UserError,
)

if TYPE_CHECKING:
    from posegaussian.dags.runtime.events import TaskFailed


class Kind(Enum):
    """Classes of failure. What is tried again is tried with the same inputs."""

    DETERMINISTIC = "deterministic"
    """It would fail again in the same way: it fails at once."""
    TRANSIENT = "transient"
    """A disk, a connection or a device stumbled: tried again `run.retries` times, with a growing pause."""
    MEMORY = "memory or crash"
    """Its process was killed or ran out of memory: once more alone in its pool, then failed."""
    TIMEOUT = "timed out"
    """It took longer than `run.timeout`: it fails at once, a second attempt would take as long."""
    LOST = "lease lost"
    """It was suspended past its lease: tried again, which finds out what came of it in the meantime."""
    HELD = "held by another run"
    """Another run works on it: waited for, and done here if that run gives it up."""
    CORRUPT = "damaged input"
    """It read a shard that is missing or damaged: the shard is made again, then it is tried once more."""
    UNFIT = "other code"
    """No worker has the code and the libraries of the run: it fails at once, what comes of it would not be what was
    asked for."""
    UNREACHED = "scheduler lost"
    """Nobody is there any more who could run it: the run ends, the next one goes on."""
    SPARED = "spared"
    """It waited on a worker that died of another task: handed out again, as if nothing had happened."""


@dataclass(frozen=True)
class Failure:
    """A task that did not end with a receipt."""

    error: str
    """One sentence."""
    details: str = ""
    """Traceback, or empty for errors the user can mend."""
    kind: Kind = Kind.DETERMINISTIC
    """What is done about it."""
    holder: Any = None
    """posegaussian.storage.archive.lease.Holder of a task that another run works on."""


class TaskTimedOut(Exception):
    """A task that took longer than `run.timeout`, so that its process was ended."""


NOT_TRANSIENT = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
"""System errors that do not pass by waiting."""

NOT_TRANSIENT_NUMBERS = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EROFS,
    errno.ENAMETOOLONG,
    errno.EINVAL,
    errno.EFBIG,
    errno.EACCES,
    errno.EPERM,
    errno.EISDIR,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.ENOENT,
)
"""Disk or quota full, read-only, forbidden, names and values no system accepts: these do not pass by waiting either."""

TRANSIENT_WORDS = ("cuda error: unknown error", "cuda driver error: unknown error")
"""What a device says that is well again a moment later."""

MEMORY_WORDS = ("cuda out of memory", "cuda error: out of memory")
"""What a device says that has too little memory left."""


def classify(error: BaseException) -> Kind:
    """The class of an exception that a task raised."""
    if isinstance(error, LeaseHeld):
        return Kind.HELD
    if isinstance(error, LeaseLost):
        return Kind.LOST
    if isinstance(error, ShardCorrupt | ShardMissing):
        return Kind.CORRUPT
    if isinstance(error, OtherCode):
        return Kind.UNFIT
    if isinstance(error, SchedulerLost):
        return Kind.UNREACHED
    if isinstance(error, UserError) and not isinstance(error, NotWritten):
        return Kind.DETERMINISTIC
    if isinstance(error, TaskTimedOut):
        return Kind.TIMEOUT
    words = str(error).lower()
    if (
        isinstance(error, MemoryError)
        or type(error).__name__ == "OutOfMemoryError"
        or any(w in words for w in MEMORY_WORDS)
    ):
        return Kind.MEMORY
    if isinstance(error, NOT_TRANSIENT) or (isinstance(error, OSError) and error.errno in NOT_TRANSIENT_NUMBERS):
        return Kind.DETERMINISTIC
    if isinstance(error, OSError) or any(w in words for w in TRANSIENT_WORDS):
        return Kind.TRANSIENT
    return Kind.DETERMINISTIC


def failure(error: BaseException) -> Failure:
    """One sentence of an error; with the traceback unless the user can mend it."""
    kind = classify(error)
    if isinstance(error, UserError):
        return Failure(str(error), "", kind, getattr(error, "holder", None))
    sentence = f"{type(error).__name__}: {error}" if kind is not Kind.TIMEOUT else str(error)
    return Failure(sentence, "".join(traceback.format_exception(error)), kind)


ADVICE = {
    Kind.TRANSIENT: "it was tried {attempts} times; look at the disk, the network or the device, then run again",
    Kind.MEMORY: (
        "it was tried once more alone; give it more memory with fewer run.workers or a larger run.memory, a device's"
        " with fewer run.gpus, or less to do with a smaller frames.size, or import with a smaller partition.frames"
    ),
    Kind.TIMEOUT: "raise run.timeout, or import with a smaller partition.frames",
}
"""What the user can do about a failure that stayed, by its class."""


def with_advice(failure: Failure, attempts: int) -> Failure:
    """A failure that is final: its sentence says what was tried and which setting helps."""
    advice = ADVICE.get(failure.kind)
    if advice is None:
        return failure
    return Failure(
        f"{failure.error}; {advice.format(attempts=attempts)}", failure.details, failure.kind, failure.holder
    )


def failures_table(
    failures: Iterable[TaskFailed], refused: Iterable[str], cameras: Mapping[str, tuple[str, ...]]
) -> Table:
    """One row a failed task or a refused sequence: where, of which class, why. `cameras` names the views of each
    sequence."""
    table = Table(title="what failed", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in ("sequence", "task", "class", "why"):
        table.add_column(column, overflow="fold")
    for sentence in refused:
        name, _, error = sentence.partition(": ")
        table.add_row(escape(name), "all", "refused", escape(error))
    for f in failures:
        table.add_row(
            escape(f.task.sequence), escape(f.task.label(cameras.get(f.task.sequence, ()))), f.kind, escape(f.error)
        )
    return table
