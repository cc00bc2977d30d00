"""`posegaussian verify`: say what in an archive is not as its receipts promise, and have it made anew; and which source
files are not what was imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.session.session import Session
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.integrity import (
    ARRAY_BROKEN,
    FOREIGN_RECEIPT,
    LEFT_OVER,
    RECEIPT_UNREADABLE,
    SOURCE_CHANGED,
    Count,
    Fault,
    faults,
    repair,
    seal_all,
)
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld


class Verified(NamedTuple):
    """What came of it."""

    status: int
    """Exit status: 1 where there is any fault."""
    following: tuple[str, ...]
    """The next useful command: no run while a source file is not what was imported, it would read it as it is."""


def verify(session: Session, names: Sequence[str], mend: bool) -> Verified:
    """Read everything again, source files too, print every fault, and with `mend` mark it for the next run."""
    told, broken, foreign = ledger.faults(session.archive), 0, 0
    for sentence in told:
        if mend:
            ledger.rebuild(session.archive)
        session.say([f"{sentence}; {'written anew' if mend else '--repair writes it anew at once'}"], "red")
    for name in names:
        try:
            sequence = session.archive.sequence(name)
            found, theirs = _sequence(session, sequence, mend)
            broken, foreign = broken + found, foreign + theirs
        except ArchiveError as e:
            session.say([f"{name}: {e}"], "red")
            broken += 1
    if broken > foreign:
        session.say(
            [
                (
                    "run again to make it anew"
                    if mend
                    else "nothing was changed; `posegaussian verify --repair` marks it, and the next run makes it anew"
                )
            ]
        )
    if not broken and not told:
        return Verified(0, ("status",))
    if not mend and (told or broken > foreign):
        return Verified(1, ("verify", "--repair"))
    return Verified(1, ("verify",) if foreign else ("run",))


def _sequence(session: Session, sequence: SequenceGroup, mend: bool) -> tuple[int, int]:
    """Verify one sequence; returns the number of faults, and of those among them that no run mends."""
    count, found, foreign = Count(), 0, 0
    for fault in faults(sequence, count):
        found += 1
        foreign += fault.foreign
        session.say(
            [f"{sequence.name}: {describe(sequence, fault)}; {_mend(sequence, fault) if mend else remedy(fault)}"],
            "red",
        )
    outcome = number(found, "fault") if found else "no faults"
    sources = f"{number(count.sources, 'source file')}, {count.source_bytes / 1e6:.1f} MB read"
    session.say(
        [f"{sequence.name}: {number(count.files, 'file')}, {count.bytes / 1e6:.1f} MB, and {sources}, {outcome}"]
    )
    if count.gone:
        session.say(
            [
                (
                    f"{sequence.name}: {number(len(count.gone), 'source file')} left out, gone since the import, for"
                    f" example {count.gone[0]}; what was made stays as it is, a task that reads one fails"
                )
            ],
            "yellow",
        )
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
    return found, foreign


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
    if fault.cause.startswith(SOURCE_CHANGED):
        return (
            "import the capture again, and what was made of the file is made anew; or put the old one back, and if"
            f" anything ran since it changed, `posegaussian run --from {STAGES[0].name}`"
        )
    if fault.foreign:
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
    if fault.foreign:
        return remedy(fault)
    try:
        repair(sequence, fault)
    except LeaseHeld as e:
        return f"left alone: {e}"
    return "deleted" if fault.receipt is None else f"the receipt of {_task(fault)} is removed"
