"""Several runs on one sequence: each says that it is there, and none replaces arrays under another."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

from dags.aside import put_aside
from dags.execute import Terms
from dags.orders import needed_arrays, prepare
from dags.plan import Plan
from storage.archive import Sequence
from storage.errors import ArchiveError, LeaseHeld
from storage.lease import SUFFIX, Holder, Lease, ended, living, read_lease, wait_for

PATIENCE = 60.0
"""Seconds to wait for another run that is making the arrays of a sequence, a matter of moments; longer where the lease of a run that died would outlast it."""


def folder(sequence: Sequence) -> Path:
    """Where the runs on a sequence say that they are there."""
    return sequence.place("_receipts/_runs")


def enter(plan: Plan, terms: Terms) -> Lease:
    """Say that a run works on a sequence, and make its arrays; the lease is dropped when the run leaves.

    Raises LeaseHeld when arrays would have to be replaced or cut while another run is there.
    """
    sequence = plan.context.sequence
    presence = Lease.take(folder(sequence) / f"{terms.run}{SUFFIX}", terms.run, "driver", terms.lease)
    try:
        _sweep(sequence, terms)
        if terms.kept is not None:
            put_aside(plan, terms.kept)
        make_arrays(plan, terms)
    except BaseException:
        presence.drop()
        raise
    return presence


def make_arrays(plan: Plan, terms: Terms) -> None:
    """Make the arrays of every stage whose effects are decided. Raises LeaseHeld like `enter`."""
    sequence = plan.context.sequence
    with wait_for(sequence.receipts / f"_arrays{SUFFIX}", terms.run, terms.lease, max(PATIENCE, 2 * terms.lease)):
        _refuse_resharded(sequence)
        _refuse_replacing(plan, terms)
        prepare(plan)


def _sweep(sequence: Sequence, terms: Terms) -> None:
    """Remove what runs left behind that were killed; their names are never used again."""
    for file in folder(sequence).glob(f"*{SUFFIX}"):
        holder = read_lease(file, terms.lease)
        if holder is not None and ended(holder, time.time()):
            file.unlink(missing_ok=True)


def others(sequence: Sequence) -> list[Holder]:
    """Runs of other processes that work on a sequence right now."""
    me = (socket.gethostname(), os.getpid())
    return [holder for _, holder in living(folder(sequence)) if (holder.host, holder.pid) != me]


def refuse_busy(sequence: Sequence, command: str) -> None:
    """Raise LeaseHeld while any run works on a sequence, for commands that need it to themselves."""
    for _, holder in living(folder(sequence)):
        raise LeaseHeld(f"{command}: sequence {sequence.name} is worked on by {holder.sentence(time.time())}; let it end first", holder)


def _refuse_resharded(sequence: Sequence) -> None:
    now = Sequence(sequence.root).partition_frames
    if now != sequence.partition_frames:
        raise ArchiveError(f"sequence {sequence.name} was cut into partitions of {now} frames since this run was planned with {sequence.partition_frames}; run again")


def _refuse_replacing(plan: Plan, terms: Terms) -> None:
    sequence = plan.context.sequence
    there = [holder for _, holder in living(folder(sequence), terms.lease) if holder.run != terms.run]
    if not there:
        return
    for spec, shape, path in needed_arrays(plan):
        if sequence.destroys(spec, shape, path):
            name = spec.name.format(path=path)
            raise LeaseHeld(f"{name} of sequence {sequence.name} must be replaced for these settings, but {there[0].sentence(time.time())} works on the sequence; let it end, or use another archive", there[0])
