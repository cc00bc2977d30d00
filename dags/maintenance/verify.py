"""`posegaussian verify`: say what in an archive is not as its receipts promise, and have it made anew."""

from __future__ import annotations

from collections.abc import Sequence

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.integrity import (
    ARRAY_BROKEN,
    FOREIGN_RECEIPT,
    GIVEN,
    LEFT_OVER,
    RECEIPT_UNREADABLE,
    Count,
    Fault,
    faults,
    repair,
    seal_all,
)
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld


def verify(session: Session, names: Sequence[str], mend: bool) -> int:
    """Read everything again, print every fault, and with `mend` mark it for the next run; returns the exit status, 1
    where there is any."""
    told, broken = ledger.faults(session.archive), 0
    for sentence in told:
        if mend:
            ledger.rebuild(session.archive)
        session.say([f"{sentence}; {'written anew' if mend else '--repair writes it anew at once'}"], "red")
    for name in names:
        try:
            sequence = session.archive.sequence(name)
            broken += _sequence(session, sequence, mend)
        except ArchiveError as e:
            session.say([f"{name}: {e}"], "red")
            broken += 1
    if broken:
        session.say(
            [
                (
                    "run again to make it anew"
                    if mend
                    else "nothing was changed; `posegaussian verify --repair` marks it, and the next run makes it anew"
                )
            ]
        )
    return 1 if broken or told else 0


def _sequence(session: Session, sequence: SequenceGroup, mend: bool) -> int:
    """Verify one sequence; returns the number of faults."""
    count, found = Count(), 0
    for fault in faults(sequence, count):
        found += 1
        session.say(
            [f"{sequence.name}: {describe(sequence, fault)}; {_mend(sequence, fault) if mend else remedy(fault)}"],
            "red",
        )
    outcome = number(found, "fault") if found else "no faults"
    session.say([f"{sequence.name}: {number(count.files, 'file')}, {count.bytes / 1e6:.1f} MB read, {outcome}"])
    if count.unsealed:
        added = mend and seal_all(sequence)
        session.say(
            [
                (
                    f"{sequence.name}: {number(added, 'checksum')} added to what an earlier version wrote"
                    if mend
                    else (
                        f"{sequence.name}: {number(count.unsealed, 'file')} of an earlier version without a checksum,"
                        " so that a changed digit in them is not noticed; --repair adds it to what is there now"
                    )
                )
            ]
        )
    if count.busy:
        session.say(
            [f"{sequence.name}: {number(len(count.busy), 'task')} left out, because a run works there now"], "yellow"
        )
    return found


def describe(sequence: SequenceGroup, fault: Fault) -> str:
    """Array, partition, view, file and cause."""
    if fault.output is None or fault.receipt is None:
        return f"{fault.file}: {fault.cause}"
    view = fault.output.view
    names = sequence.capture.rig.names
    place = [
        fault.output.array,
        *([f"partition {fault.receipt.partition}"] if fault.receipt.partition is not None else []),
    ]
    place += [f"view {names[view] if view < len(names) else view}"] if view is not None else []
    return f"{', '.join(place)}: {fault.file}: {fault.cause}"


def remedy(fault: Fault) -> str:
    """What a repair would do."""
    if fault.cause == LEFT_OVER:
        return "harmless; --repair deletes it"
    if fault.file.startswith(GIVEN):
        return "no run makes it: film the scene again with `posegaussian simulate`, or put the old files back"
    if fault.cause.startswith(ARRAY_BROKEN):
        return "--repair removes its description, and the next run makes the array anew"
    if fault.cause == RECEIPT_UNREADABLE or fault.cause.startswith(FOREIGN_RECEIPT):
        return "it proves nothing, so the next run makes its task anew; --repair deletes it"
    return f"--repair would remove the receipt of {_task(fault)}, so that the next run makes it anew"


def _task(fault: Fault) -> str:
    assert fault.receipt is not None
    r = fault.receipt
    return Task("", r.stage, r.partition, r.view, r.path).label()


def _mend(sequence: SequenceGroup, fault: Fault) -> str:
    if fault.file.startswith(GIVEN):
        return remedy(fault)
    try:
        repair(sequence, fault)
    except LeaseHeld as e:
        return f"left alone: {e}"
    return "deleted" if fault.receipt is None else f"the receipt of {_task(fault)} is removed"
