"""Several runs on one sequence: each says that it is there and which arrays it counts on, and none replaces these under
another."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import SUFFIX, Holder, Lease, ended, living, read_lease
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import LeaseHeld

COUNTED_ON = ".arrays"
"""Ending of what a run says of arrays, beside its lease."""

PATIENCE = 5.0
"""Seconds in which a run that came says which arrays it counts on, a matter of moments."""


@dataclass(frozen=True)
class Presence:
    """That a run works on a sequence."""

    lease: Lease

    @classmethod
    def of(cls, sequence: SequenceGroup, terms: RunTerms) -> Presence:
        """A run comes. Raises NotWritten."""
        return cls(Lease.take(folder(sequence) / f"{terms.run}{SUFFIX}", terms.run, "driver", terms.lease))

    def __enter__(self) -> Presence:
        return self

    def __exit__(self, *error: object) -> None:
        self.drop()

    def drop(self) -> None:
        """The run leaves."""
        with contextlib.suppress(OSError):  # a disk that became read-only: it says nothing once the lease ended
            self.lease.file.with_suffix(COUNTED_ON).unlink(missing_ok=True)
        self.lease.drop()


def count_on(sequence: SequenceGroup, terms: RunTerms, arrays: Mapping[str, str]) -> None:
    """Say which arrays {name: digest of its description} a run that is there counts on. Raises NotWritten."""
    write_atomically(folder(sequence) / f"{terms.run}{COUNTED_ON}", json.dumps(arrays).encode())


def contradicting(sequence: SequenceGroup, terms: RunTerms, name: str, description: str) -> Holder | None:
    """Another run that is there and counts on an array of another description, or does not say on which it does."""
    for file, holder in living(folder(sequence), terms.lease):
        if holder.run != terms.run:
            told = _counted_on(file.with_suffix(COUNTED_ON))
            if told is None or told.get(name, description) != description:
                return holder
    return None


def _counted_on(file: Path) -> dict[str, str] | None:
    """What a run says of arrays; None where it says nothing for some seconds."""
    until = time.monotonic() + PATIENCE
    while True:
        with contextlib.suppress(FileNotFoundError, ValueError):
            return {str(name): str(told) for name, told in json.loads(file.read_bytes()).items()}
        if time.monotonic() > until:
            return None
        time.sleep(0.05)


def folder(sequence: SequenceGroup) -> Path:
    """Where the runs on a sequence say that they are there."""
    return sequence.place("_receipts/_runs")


def sweep(sequence: SequenceGroup, terms: RunTerms) -> None:
    """Remove what runs left behind that were killed, where the disk lets it go; their names are never used again."""
    for file in folder(sequence).glob(f"*{SUFFIX}"):
        holder = read_lease(file, terms.lease)
        if holder is not None and ended(holder, time.time()):
            with contextlib.suppress(OSError):
                file.with_suffix(COUNTED_ON).unlink(missing_ok=True)
                file.unlink(missing_ok=True)


def others(sequence: SequenceGroup) -> list[Holder]:
    """Runs of other processes that work on a sequence right now."""
    me = (socket.gethostname(), os.getpid())
    return [holder for _, holder in living(folder(sequence)) if (holder.host, holder.pid) != me]


def refuse_busy(sequence: SequenceGroup, command: str) -> None:
    """Raise LeaseHeld while any run works on a sequence, for commands that need it to themselves."""
    for _, holder in living(folder(sequence)):
        raise LeaseHeld(
            f"{command}: sequence {sequence.name} is worked on by {holder.sentence(time.time())}; let it end first",
            holder,
        )
