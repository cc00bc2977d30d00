"""The named errors of the project: each says the thing, the value, the bound and the next step.

Every error that a user can cause derives from `UserError`; the command line prints its sentence and no traceback.
"""

from typing import Any


class UserError(Exception):
    """Something the user can mend: a path, a setting, a file's content. Exit status 2 on the command line."""


class SourceError(UserError):
    """A source file is missing, unreadable, changed since import, or contradicts another one."""


class CalibrationError(UserError):
    """Cameras that are missing, not finite, not rigid, or do not fit the pictures they belong to."""


class ConfigError(UserError):
    """One or more faults of a configuration file, each with file:line:column."""


class ArchiveError(UserError):
    """An archive that does not exist, is of a newer format, or lies where runs are not possible."""


class BrokenRecord(ArchiveError):
    """A sequence whose own record cannot be read; importing it again writes a new one."""


class ShardMissing(ArchiveError):
    """A shard that a receipt promises is not there."""


class LedgerDamaged(ArchiveError):
    """A ledger that is none: what it would say follows from receipts and logs."""


class ShardCorrupt(ArchiveError):
    """A shard whose size or content is not what its receipt promises."""


class LeaseHeld(ArchiveError):
    """Work that another run is doing right now; `holder` (posegaussian.storage.archive.lease.Holder) says who,
    where, since when."""

    def __init__(self, sentence: str, holder: Any = None) -> None:
        super().__init__(sentence, holder)
        self.holder = holder

    def __str__(self) -> str:
        return str(self.args[0])


class LeaseLost(ArchiveError):
    """A writer whose lease ended while it was suspended or cut off: it stops and writes nothing more."""


class SchedulerLost(UserError):
    """The scheduler of a run does not answer any more; what is done is kept."""


class NotWritten(UserError, OSError):
    """A file or folder that the system did not take: disk full, read-only, no permission, no such place. An OSError
    with its number."""

    def __init__(self, number: int, sentence: str) -> None:
        super().__init__(number, sentence)

    def __str__(self) -> str:
        return str(self.args[1])


class OtherCode(UserError):
    """A process whose code or libraries are not those of the run,
    so that its results would not be what their receipts claim."""

    def __init__(self, sentence: str, worker: str = "", versions: dict[str, str] | None = None) -> None:
        super().__init__(sentence, worker, versions)
        self.worker = worker
        """Address of the worker that refused; empty where it is no worker."""
        self.versions = versions or {}
        """What that process has: version or digest by name."""

    def __str__(self) -> str:
        return str(self.args[0])
