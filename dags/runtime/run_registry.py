"""Several runs on one sequence: each says that it is there, and none replaces arrays under another."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import SUFFIX, Holder, ended, living, read_lease
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import LeaseHeld


def folder(sequence: SequenceGroup) -> Path:
    """Where the runs on a sequence say that they are there."""
    return sequence.place("_receipts/_runs")


def sweep(sequence: SequenceGroup, terms: RunTerms) -> None:
    """Remove what runs left behind that were killed; their names are never used again."""
    for file in folder(sequence).glob(f"*{SUFFIX}"):
        holder = read_lease(file, terms.lease)
        if holder is not None and ended(holder, time.time()):
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
