"""A run enters a sequence: it says that it is there, and makes the arrays that its tasks write to."""

from __future__ import annotations

import time
from collections.abc import Mapping

from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.ordering import counted_on, needed_arrays, prepare
from posegaussian.dags.runtime.run_registry import Presence
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import SUFFIX, wait_for
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld

PATIENCE = 60.0
"""Seconds to wait for another run that is making the arrays of a sequence, a matter of moments; longer where the
lease of a run that died would outlast it."""


def enter(plan: Plan, terms: RunTerms) -> Presence:
    """Say that a run works on a sequence, and make its arrays; what is returned is dropped when the run leaves.

    Raises LeaseHeld when arrays would have to be replaced or cut that another run counts on as they are.
    """
    sequence = plan.context.sequence
    here = Presence.of(sequence, terms)
    try:
        run_registry.sweep(sequence, terms)
        make_arrays(plan, terms)
    except BaseException:
        here.drop()
        raise
    return here


def make_arrays(plan: Plan, terms: RunTerms) -> None:
    """Make the arrays of every stage whose effects are decided. Raises LeaseHeld like `enter`."""
    sequence, arrays = plan.context.sequence, counted_on(plan)
    run_registry.count_on(sequence, terms, arrays)  # first: who makes arrays meanwhile looks at it
    with wait_for(sequence.receipts / f"_arrays{SUFFIX}", terms.run, terms.lease, max(PATIENCE, 2 * terms.lease)):
        _refuse_resharded(sequence)
        _refuse_replacing(plan, terms, arrays)
        prepare(plan)


def _refuse_resharded(sequence: SequenceGroup) -> None:
    now = SequenceGroup(sequence.root).partition_frames
    if now != sequence.partition_frames:
        raise ArchiveError(
            f"sequence {sequence.name} was cut into partitions of {now} frames since this run was planned with"
            f" {sequence.partition_frames}; run again"
        )


def _refuse_replacing(plan: Plan, terms: RunTerms, arrays: Mapping[str, str]) -> None:
    """Raise LeaseHeld for the first array that must be replaced and that another run counts on as it is; runs of the
    same settings count on the same ones, whoever makes them."""
    sequence = plan.context.sequence
    for spec, shape, path in needed_arrays(plan):
        name = spec.name.format(path=path)
        if sequence.destroys(spec, shape, path):
            there = run_registry.contradicting(sequence, terms, name, arrays[name])
            if there is not None:
                raise LeaseHeld(
                    f"{name} of sequence {sequence.name} must be replaced for these settings, but"
                    f" {there.sentence(time.time())} works on the sequence; let it end, or use another archive",
                    there,
                )
