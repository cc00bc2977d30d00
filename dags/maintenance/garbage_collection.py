"""`posegaussian gc`: what could go, how many bytes that frees and what would have to be computed again; deletes only
when told.

| kind | what | made again by |
| --- | --- | --- |
| arrays | outputs that `keep` would have dropped: all that reads them is done | the next thing that needs them |
| paths | pictures and measures of camera paths that are not asked for now | `export --path` |
| range | partitions beyond the present `frames.range` | a longer range |
| stages | outputs that the capture does not need under these settings | other settings |
| strays | half written files, shards without a receipt | nothing needs them |
| variants | archives of `tradeoff`, `evaluate`; results of other settings (`run.keep_variants`) | these; those |
| runs | settings and logs of runs but the newest ones | not at all: they are history |

Giving something up needs a little room itself: a lease, and where bytes are dropped a receipt that says so. On a disk
that is full to the last byte `apply` therefore first deletes, piece by piece and only until the lease can be written,
of what it was told to delete: half written files and stray shards, then tasks with their receipts, and of arrays the
shards of one output at a time. Nobody can begin there meanwhile, as a run needs a lease, too. A kill in that moment
leaves at worst a receipt whose shard is missing, which the next plan sees: that one output is then made again where it
is needed.

Where sequences are named, of variants what belongs to them is offered, and no runs: a run may be of several.

Never offered: sources, copied or not, cameras, constants of the survey, receipts of what stays, anything of a stage
that this version does not know, and, while a source file is missing, anything that was computed from the sources.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial as given
from pathlib import Path
from typing import TypeVar

from rich.markup import escape
from rich.table import Table

from posegaussian.dags.humanize.listing import listing
from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.maintenance.reshard import leftovers
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.retention import droppable, lost_source, settled_outputs
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import PRODUCERS, Task
from posegaussian.dags.planning.variants import FOLDER as VARIANTS
from posegaussian.dags.planning.variants import variants
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.entering import PATIENCE
from posegaussian.dags.session.session import Session
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive import set_aside as kept
from posegaussian.storage.archive.deletion import (
    bytes_of,
    delete_files,
    delete_folder,
    drop_outputs,
    folder_bytes,
    forget,
    partial_files,
    strays,
)
from posegaussian.storage.archive.lease import SUFFIX, own_name, wait_for
from posegaussian.storage.archive.ledger import RUNS
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.archive.store import Archive, SequenceGroup, sequence_name_fault
from posegaussian.storage.files.names import files_below, folders_in
from posegaussian.storage.files.write import FULL
from posegaussian.storage.model.errors import ConfigError, NotWritten
from posegaussian.storage.model.spec import ArraySpec

KINDS = ("arrays", "paths", "range", "stages", "strays", "variants", "runs")
"""Kinds of what could go, as `--kind` names them."""

EASIEST = ("runs", "variants", "strays", "paths", "range", "stages", "arrays")
"""Kinds in the order in which they are deleted: those first that need no room themselves."""

END = object()
"""What is left when all pieces are gone."""

T = TypeVar("T")

KEPT_RUNS = 20
"""Newest runs whose settings and logs stay."""


@dataclass(frozen=True)
class Deletable:
    """Something that could go."""

    kind: str
    """One of KINDS."""
    sequence: str
    """Its sequence, or ""."""
    what: str
    """What it is, for people."""
    bytes: int
    """Bytes on disk it frees."""
    again: str
    """What would have to be computed again, and when."""
    delete: Callable[[], object]
    """Deletes it."""
    pieces: Callable[[], Iterator[None]] = lambda: iter(())
    """Deletes it, too, one piece with every step, and writes nothing: for a disk on which nothing can be written."""
    holds: tuple[SequenceGroup, ...] = ()
    """Sequences of variants that go with it."""


def items(plans: Sequence[Plan], archive: Archive, names: Collection[str] | None = None) -> list[Deletable]:
    """All that could go of some planned sequences and of the archive they lie in; `names`: sequences that alone are
    asked for."""
    found: list[Deletable] = []
    for plan in plans:
        found += [*_strays(plan), *_unwanted(plan)]
        if lost_source(plan.context) is None:
            found += _arrays(plan)
    return [*found, *_variants(archive, names), *_kept(archive, names), *(_runs(archive) if names is None else ())]


def notes(plans: Sequence[Plan]) -> list[str]:
    """Sentences about what is held back."""
    lost = {p.context.sequence.name: lost_source(p.context) for p in plans}
    return [
        f"{name}: no computed array is offered, because {file} is not there and nothing could be made again"
        for name, file in lost.items()
        if file is not None
    ]


def apply(chosen: Sequence[Deletable], plans: Sequence[Plan]) -> int:
    """Delete; returns the bytes freed. Raises ArchiveError before anything is touched when a run is at work on a
    sequence or on a variant that goes, NotWritten where there is no room for its own lease and none can be made."""
    sequences = {p.context.sequence.name: p.context.sequence for p in plans}
    for sequence in (*sequences.values(), *(s for item in chosen for s in item.holds)):
        run_registry.refuse_busy(sequence, "gc --apply")
    freed = 0
    for item in sorted(chosen, key=lambda i: EASIEST.index(i.kind)):
        if item.sequence:
            _delete(sequences[item.sequence], item)
        else:
            item.delete()
        freed += item.bytes
    return freed


def _delete(sequence: SequenceGroup, item: Deletable) -> None:
    """Delete under the lease of a sequence's arrays; where the disk has no room for what that writes, pieces of the
    item make some.

    Raises NotWritten where all pieces did not.
    """
    pieces = item.pieces()
    while True:
        try:
            with wait_for(sequence.receipts / f"_arrays{SUFFIX}", own_name("gc"), 60.0, PATIENCE):
                run_registry.refuse_busy(sequence, "gc --apply")
                item.delete()
            return
        except NotWritten as e:
            if e.errno not in FULL:
                raise
            run_registry.refuse_busy(sequence, "gc --apply")
            if next(pieces, END) is END:
                raise


def _one_by_one(delete: Callable[[T], object], things: Iterable[T]) -> Iterator[None]:
    """Delete one of some things with every step."""
    for thing in things:
        delete(thing)
        yield


def _arrays(plan: Plan) -> Iterator[Deletable]:
    """One item an array: outputs whose readers are all done."""
    sequence, settings = plan.context.sequence, plan.context.settings
    groups: dict[str, dict[Task, list[tuple[str, int | None]]]] = defaultdict(lambda: defaultdict(list))
    sizes: dict[str, int] = defaultdict(int)
    for task, output in settled_outputs(plan, droppable(settings, declared=True)):
        groups[output.array][task].append((output.array, output.view))
        sizes[output.array] += bytes_of(output.files)
    for array, tasks in groups.items():
        stage = next(iter(tasks)).stage

        def drop(tasks: dict[Task, list[tuple[str, int | None]]] = tasks) -> None:
            for task, outputs in tasks.items():
                plan.book.receipts[task] = drop_outputs(sequence, plan.book.receipts[task], outputs)

        def pieces(tasks: dict[Task, list[tuple[str, int | None]]] = tasks) -> Iterator[None]:
            kept = (
                o
                for task, outputs in tasks.items()
                for o in plan.book.receipts[task].outputs
                if (o.array, o.view) in outputs and not o.dropped
            )
            return _one_by_one(lambda o: delete_files(sequence.place(f.key) for f in o.files), kept)

        yield Deletable(
            "arrays",
            sequence.name,
            f"{array}, {number(len(tasks), 'task')}",
            sizes[array],
            f"{stage} ({_cost(plan, list(tasks))}) when something reads it again",
            drop,
            pieces,
        )


def _cost(plan: Plan, tasks: list[Task]) -> str:
    """How long some tasks took, by their own receipts."""
    seconds = [plan.book.receipts[t].facts.get("seconds") for t in tasks]
    known = [s for s in seconds if s is not None]
    return f"{sum(known):.0f} s" if len(known) == len(tasks) else "time unknown"


def _unwanted(plan: Plan) -> Iterator[Deletable]:
    """Receipts and outputs of tasks that are not in the plan:
    other camera paths, a longer range, stages that are not needed."""
    sequence, lost = plan.context.sequence, lost_source(plan.context)
    groups: dict[tuple[str, str], list[Receipt]] = defaultdict(list)
    for task, receipt in plan.book.receipts.items():
        kind = _kind(plan, task)
        if kind is not None:
            groups[kind, _subject(kind, task)].append(receipt)
    if lost is not None:
        return
    for (kind, subject), receipts in groups.items():

        def remove(kind: str = kind, receipts: list[Receipt] = receipts) -> None:
            for r in receipts:
                forget(sequence, r)
            if kind == "paths":
                for path in {r.path for r in receipts}:
                    for folder in ("rendering", "metrics"):
                        delete_folder(sequence.place(f"{folder}/{path}"))

        stages = " and ".join(dict.fromkeys(r.stage for r in receipts))
        again = {
            "paths": f"{stages} when the path is asked for again",
            "range": f"{stages} when the range covers it again",
            "stages": f"{stages} under settings that need it",
        }[kind]
        size = sum(bytes_of(o.files) for r in receipts for o in r.outputs if not o.dropped)
        yield Deletable(
            kind,
            sequence.name,
            subject,
            size,
            again,
            remove,
            given(_one_by_one, given(forget, sequence), receipts),
        )


def _kind(plan: Plan, task: Task) -> str | None:
    """Why a receipt is not in the plan; None for what stays."""
    if task in plan.verdicts and task.stage not in plan.unneeded:
        return None
    try:
        stage = stage_named(task.stage)
    except KeyError:
        return None  # of another version: it could not be made again here
    if stage.sequence_wide:
        return None  # constants: taken anew they could come out different
    if task.path is not None and task.path not in plan.context.paths:
        return "paths"
    if task.partition is not None and task.partition not in plan.context.grid.partitions:
        return "range"
    return "stages"


def _subject(kind: str, task: Task) -> str:
    return {
        "paths": f"camera path {task.path}",
        "range": f"{task.stage} beyond the range",
        "stages": f"{task.stage}, not needed",
    }[kind]


def _strays(plan: Plan) -> Iterator[Deletable]:
    """Half written files, shards without a receipt, and what an interrupted reshard left."""
    sequence = plan.context.sequence
    partial = partial_files(sequence.root)
    known = [s.name for _, s in PRODUCERS.values() if isinstance(s, ArraySpec)] + [
        n for n, (_, s) in PRODUCERS.items() if not isinstance(s, ArraySpec)
    ]
    names = {n for n in known if "{path}" not in n} | {
        n.format(path=p.name) for n in known if "{path}" in n for p in _path_folders(sequence)
    }
    loose = list(strays(sequence, plan.book.receipts.values(), names))
    size = sum(p.stat().st_size if p.is_file() else folder_bytes(p) for p in [*partial, *loose])
    if partial or loose:

        def remove() -> None:
            delete_files(p for p in [*partial, *loose] if p.is_file())
            for p in partial:
                if p.is_dir():
                    delete_folder(p)

        yield Deletable(
            "strays",
            sequence.name,
            f"{len(partial)} half written files, {len(loose)} shards without a receipt",
            size,
            "nothing",
            remove,
            lambda: _one_by_one(lambda p: delete_files([p]), [p for p in [*partial, *loose] if p.is_file()]),
        )
    for folder in leftovers(sequence):
        yield Deletable(
            "strays",
            sequence.name,
            f"left over from resharding: {folder.name}",
            folder_bytes(folder),
            "nothing",
            given(delete_folder, folder),
            given(_one_by_one, delete_folder, [folder]),
        )


def _path_folders(sequence: SequenceGroup) -> list[Path]:
    return [p for top in ("rendering", "metrics") for p in folders_in(sequence.place(top))]


def _variants(archive: Archive, names: Collection[str] | None) -> Iterator[Deletable]:
    """All variants, or what they have of some sequences."""
    beside = [(v, f) for v in variants(archive) for f in folders_in(v.root) if sequence_name_fault(f.name) is None]
    inside = [(v, SequenceGroup(f)) for v, f in beside if names is None or f.name in names]
    going = [archive.place(VARIANTS)] if names is None else [s.root for _, s in inside]

    def remove() -> None:
        for folder in going:
            delete_folder(folder)

    if any(folder.is_dir() for folder in going):
        yield Deletable(
            "variants",
            "",
            f"{number(len({v.root for v, _ in inside}), 'variant')} of tradeoff and evaluate",
            sum(s.st_size for f in going for p in files_below(f) if (s := os.lstat(p)).st_nlink == 1),
            "the levels of the next tradeoff, the methods of the next evaluate",
            remove,
            holds=tuple(s for _, s in inside),
        )


def _kept(archive: Archive, names: Collection[str] | None) -> Iterator[Deletable]:
    lying = [e for e in kept.entries(archive) if names is None or e.folder.parent.name in names]
    if lying:
        yield Deletable(
            "variants",
            "",
            f"{number(len(lying), 'result')} of other settings (run.keep_variants)",
            sum(e.own for e in lying),
            "runs that go back to these settings",
            lambda: kept.clear(archive, names),
        )


def _runs(archive: Archive) -> Iterator[Deletable]:
    old = folders_in(archive.place(RUNS))[:-KEPT_RUNS]

    def remove() -> None:
        for folder in old:
            delete_folder(folder)

    if old:
        yield Deletable(
            "runs",
            "",
            f"settings and logs of the {len(old)} oldest runs",
            sum(folder_bytes(p) for p in old),
            "not at all: their history is lost",
            remove,
        )


def collect(session: Session, globs: Sequence[str], kinds: Sequence[str], delete: bool) -> tuple[int, bool]:
    """Show what could go of the archive, or of sequences that any glob matches, delete it where told; returns the exit
    status and whether anything could go. Raises ConfigError for an unknown kind."""
    for kind in kinds:
        if kind not in KINDS:
            raise ConfigError(f"gc: no kind {kind!r}; the kinds are {', '.join(KINDS)}")
    names = session.names(globs)
    plans, failed = session.usable(names, (), Selection())
    found = [i for i in items(plans, session.archive, names if globs else None) if not kinds or i.kind in kinds]
    if found:
        session.console.print(table(found, session.console.width))
    session.say([*notes(plans), *failed], "yellow")
    total = gigabytes(sum(i.bytes for i in found))
    if not found:
        session.say(["nothing could go"])
    elif delete:
        session.say([f"deleted: {gigabytes(apply(found, plans))}"])
    else:
        session.say([f"{total} could go; nothing was deleted: add --apply, and --kind to choose"])
    return (1 if failed else 0), bool(found)


def table(found: Sequence[Deletable], width: int) -> Table:
    """One row an item, the largest first within its kind. `width`: columns of the terminal."""
    ordered = sorted(found, key=lambda i: (KINDS.index(i.kind), i.sequence, -i.bytes))
    told = [(i.kind, escape(i.sequence), escape(i.what), gigabytes(i.bytes), escape(i.again)) for i in ordered]
    return listing(("kind", "sequence", "what", "bytes", "made again by"), told, width, whole=("bytes",))
