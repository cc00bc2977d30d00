"""A run enters a sequence: it says that it is there, and makes the arrays that its tasks write to."""

from __future__ import annotations

import time

from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.ordering import needed_arrays, prepare
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import SUFFIX, Lease, living, wait_for
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld

PATIENCE = 60.0
"""Seconds to wait for another run that is making the arrays of a sequence, a matter of moments; longer where the
lease of a run that died would outlast it."""


def enter(plan: Plan, terms: RunTerms) -> Lease:
    """Say that a run works on a sequence, and make its arrays; the lease is dropped when the run leaves.

    Raises LeaseHeld when arrays would have to be replaced or cut while another run is there.
    """
    sequence = plan.context.sequence
    here = Lease.take(run_registry.folder(sequence) / f"{terms.run}{SUFFIX}", terms.run, "driver", terms.lease)
    try:
        run_registry.sweep(sequence, terms)
        make_arrays(plan, terms)
    except BaseException:
        here.drop()
        raise
    return here


def make_arrays(plan: Plan, terms: RunTerms) -> None:
    """Make the arrays of every stage whose effects are decided. Raises LeaseHeld like `enter`."""
    sequence = plan.context.sequence
    with wait_for(sequence.receipts / f"_arrays{SUFFIX}", terms.run, terms.lease, max(PATIENCE, 2 * terms.lease)):
        _refuse_resharded(sequence)
        _refuse_replacing(plan, terms)
        prepare(plan)


def _refuse_resharded(sequence: SequenceGroup) -> None:
    now = SequenceGroup(sequence.root).partition_frames
    if now != sequence.partition_frames:
        raise ArchiveError(
            f"sequence {sequence.name} was cut into partitions of {now} frames since this run was planned with"
            f" {sequence.partition_frames}; run again"
        )


def _refuse_replacing(plan: Plan, terms: RunTerms) -> None:
    sequence = plan.context.sequence
    there = [holder for _, holder in living(run_registry.folder(sequence), terms.lease) if holder.run != terms.run]
    if not there:
        return
    for spec, shape, path in needed_arrays(plan):
        if sequence.destroys(spec, shape, path):
            name = spec.name.format(path=path)
            raise LeaseHeld(
                f"{name} of sequence {sequence.name} must be replaced for these settings, but"
                f" {there[0].sentence(time.time())} works on the sequence; let it end, or use another archive",
                there[0],
            )
