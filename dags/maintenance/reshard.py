"""`posegaussian reshard`: another partition length without computing anything again.

A whole new sequence is built beside the old one, `<archive>/_reshard/new/<name>`: every array cut anew, every receipt
keyed anew, with content digests taken from the bytes; what is not partitioned is linked. When all of it is on disk the
two folders change places by two renames. A death before the first leaves the old sequence, one between them is
finished by whoever opens the archive next (`posegaussian.storage.archive.store`), one after them leaves the new
sequence; never a mixture.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.fingerprint import all_parts, own_parts
from posegaussian.dags.planning.plan import Plan, State, TaskVerdict
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product, Task, tasks
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.ordering import prepare
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.chunk_keys import named_as_in
from posegaussian.storage.archive.deletion import folder_bytes
from posegaussian.storage.archive.lease import SUFFIX, Lease, own_name
from posegaussian.storage.archive.receipts import Output, Receipt, write_receipt
from posegaussian.storage.archive.records import write_record
from posegaussian.storage.archive.shards import write_array, write_table
from posegaussian.storage.archive.store import RESHARD, SOURCES, Archive, SequenceGroup
from posegaussian.storage.files.write import link_or_copy, link_tree, make_folder, sync_folder
from posegaussian.storage.model.errors import ArchiveError, NotWritten
from posegaussian.storage.model.spec import TableSpec, digest

COPIED_BYTES = 1e8
"""More than the old sequence's bytes that must be free: arrays are cut anew beside the old ones."""


def reshard(plan: Plan, frames: int, give_up: bool = False) -> list[str]:
    """Cut a sequence into partitions of `frames` frames; returns sentences about what was done.

    What is made but not fresh, or not asked for by the plan, cannot be keyed anew: it is given up where `give_up` says
    so.

    Raises:
        ArchiveError: a run or another reshard is at work on it or was since it was planned, something would be given
            up, bytes were dropped, or the disk is too full.
        NotWritten: the disk filled up meanwhile; the sequence is as it was.
    """
    sequence = plan.context.sequence
    if frames == sequence.partition_frames:
        return [f"sequence {sequence.name} has partitions of {number(frames, 'frame')} already"]
    lost = _given_up(plan)
    if lost and not give_up:
        raise ArchiveError(
            f"reshard: {'; '.join(lost)}; `posegaussian run` first,"
            " name the paths with --path, or pass --give-up to let it go"
        )
    _refuse_dropped(plan)
    _refuse_full_disk(sequence)
    with Lease.take(sequence.receipts / f"_arrays{SUFFIX}", own_name("reshard")) as lease:
        run_registry.refuse_busy(sequence, "reshard")
        _refuse_outdated(plan)
        try:
            made = _build(plan, frames, lease)
        except NotWritten:
            lease.check()
            shutil.rmtree(_side(sequence, "new"), ignore_errors=True)
            raise
        lease.check()
        switch(sequence)
    return [
        (
            f"sequence {sequence.name}: partitions of {number(frames, 'frame')} instead of {sequence.partition_frames},"
            f" {number(made, 'task')} keyed anew, nothing computed"
        ),
        *(f"given up: {sentence}" for sentence in lost),
    ]


def _given_up(plan: Plan) -> list[str]:
    """Sentences about receipts that cannot be carried over."""
    stale = [t for t, v in plan.verdicts.items() if v.state is not State.FRESH and t in plan.book.receipts]
    other = [t for t in plan.book.receipts if t not in plan.verdicts]
    paths = sorted({str(t.path) for t in other if t.path is not None})
    said = (
        [f"{number(len(stale), 'task')} of {', '.join(dict.fromkeys(t.stage for t in stale))} are made but not fresh"]
        if stale
        else []
    )
    said += [f"camera paths {', '.join(paths)} are rendered but not asked for"] if paths else []
    rest = [t for t in other if t.path is None]
    if rest:
        stages = ", ".join(dict.fromkeys(t.stage for t in rest))
        said.append(f"{number(len(rest), 'task')} of {stages} are outside the range or not needed")
    return said


def _refuse_dropped(plan: Plan) -> None:
    """Raise where bytes are gone that new digests would have to be taken from."""
    dropped = {
        o.array: stage
        for t in plan.verdicts
        if t in plan.book.receipts
        for o in plan.book.receipts[t].outputs
        if o.dropped and t.partition is not None
        for stage in [t.stage]
    }
    if dropped:
        force = " ".join(f"--force {s}" for s in dict.fromkeys(dropped.values()))
        raise ArchiveError(
            f"reshard: {', '.join(sorted(dropped))} of sequence {plan.context.sequence.name} was dropped, and digests"
            " of other partitions come from the bytes;"
            f" `posegaussian run --set run.keep=everything {force}` makes them again"
        )


def _refuse_outdated(plan: Plan) -> None:
    """Raise ArchiveError where the sequence is not as it was planned: what another command made since would be lost."""
    context, now = plan.context, SequenceGroup(plan.context.sequence.root)
    made = Book.open(dataclasses.replace(context, sequence=now)).receipts
    if now.partition_frames != context.sequence.partition_frames or _made(made) != _made(plan.book.receipts):
        raise ArchiveError(f"reshard: another command changed sequence {now.name} meanwhile; give this one again")


def _made(receipts: Mapping[Task, Receipt]) -> dict[Task, tuple[str, tuple[Output, ...]]]:
    """What tasks made, and from what."""
    return {t: (r.fingerprint, r.outputs) for t, r in receipts.items()}


def _refuse_full_disk(sequence: SequenceGroup) -> None:
    need, free = folder_bytes(sequence.root) + COPIED_BYTES, shutil.disk_usage(sequence.root).free
    if need > free:
        raise ArchiveError(
            f"reshard: the arrays are cut anew beside the old ones and need {gigabytes(need)}, {sequence.root} has"
            f" {gigabytes(free)} free; make room (`posegaussian gc` says what could go)"
        )


def _build(plan: Plan, frames: int, lease: Lease) -> int:
    """The new sequence, whole, below RESHARD; returns the number of its receipts.

    Raises LeaseLost before it writes where another one builds by now.
    """
    old = plan.context.sequence
    root = _side(old, "new")
    shutil.rmtree(root, ignore_errors=True)
    make_folder(root)
    write_record(root, {**old.record, "partition_frames": frames})
    for name in ("source", SOURCES):
        link_tree(old.place(name), root / name)
    context = dataclasses.replace(plan.context, sequence=SequenceGroup(root))
    anew = Plan(
        context, Book(context), {t: TaskVerdict(t, State.STALE, ()) for t in tasks(context)}, context.unneeded()
    )
    prepare(anew)
    results = Results(plan.context)
    for task in anew.verdicts:
        digests = anew.book.digests(task)
        if (
            task.stage in anew.unneeded
            or digests is None
            or any(plan.verdicts[t].state is not State.FRESH for t in _sources(plan.context, context, task))
        ):
            continue
        lease.check()
        receipt = (
            _linked(results, context, task, plan.book.receipts[task], digests)
            if task.partition is None
            else _cut(results, plan.book, context, task, digests)
        )
        write_receipt(context.sequence, receipt)
        anew.book.add(task, receipt)
    return len(anew.book.receipts)


def _sources(old: Context, new: Context, task: Task) -> list[Task]:
    """The old tasks that made the frames of a new one."""
    return (
        [task]
        if task.partition is None
        else [task._replace(partition=p) for p in old.grid.touched(new.grid.bounds(task.partition))]
    )


def _linked(
    results: Results, context: Context, task: Task, receipt: Receipt, digests: Mapping[Product, str]
) -> Receipt:
    """What is not partitioned along time, as it is; keyed by what it reads now where that is."""
    sequence = context.sequence
    own = named_as_in(sequence, receipt)
    if not stage_named(task.stage).sequence_wide:
        parts = all_parts(context, task, own_parts(context, task), digests)
        own = dataclasses.replace(own, parts=parts, fingerprint=digest(parts))
    for there, output in zip(receipt.outputs, own.outputs, strict=True):
        for old, new in zip(there.files, output.files, strict=True):
            link_or_copy(results.context.sequence.place(old.key), sequence.place(new.key))
    return own


def _cut(results: Results, book: Book, context: Context, task: Task, digests: Mapping[Product, str]) -> Receipt:
    """The receipt of a new task, whose outputs are cut from those of the old ones."""
    sources = _sources(book.context, context, task)
    receipts = [book.receipts[t] for t in sources]
    parts = all_parts(context, task, own_parts(context, task), digests)
    outputs = tuple(_output(results, context, task, receipts, o) for o in receipts[0].outputs)
    warnings = tuple(dict.fromkeys(w for r in receipts for w in r.warnings))
    return Receipt(
        task.stage,
        task.partition,
        task.view,
        task.path,
        digest(parts),
        parts,
        outputs,
        warnings,
        _facts(book.context, context, task, sources, receipts),
    )


def _output(results: Results, context: Context, task: Task, receipts: list[Receipt], old: Output) -> Output:
    """One output cut anew."""
    sequence = context.sequence
    spec = next(w for w in stage_named(task.stage).writes if w.name.format(path=task.path) == old.array)
    assert task.partition is not None, f"{task.label()} has no frames to cut"
    frames = context.grid.bounds(task.partition)
    if isinstance(spec, TableSpec):
        rows = [
            r
            for r in results.rows([o for receipt in receipts for o in receipt.outputs if o.array == old.array])
            if r["frame"] in frames
        ]
        return write_table(
            sequence, spec, task.path or "", task.partition, {c: [r[c] for r in rows] for c, _ in spec.columns}
        )
    return write_array(
        sequence,
        spec,
        task.path or "",
        frames,
        task.partition,
        old.view,
        np.ascontiguousarray(results.read(old.array, frames, old.view)),
    )


def _facts(old: Context, new: Context, task: Task, sources: list[Task], receipts: list[Receipt]) -> dict[str, Any]:
    """Circumstances of the first task, with the seconds and sizes of the share that came from each."""
    facts = dict(receipts[0].facts)
    own = new.grid.bounds(task.partition or 0)
    shares = [
        len(set(own) & set(old.grid.bounds(t.partition or 0))) / len(old.grid.bounds(t.partition or 0)) for t in sources
    ]
    for key in ("seconds", "warm_up", "cpu_seconds", "work", "raw_bytes"):
        if all(r.facts.get(key) is not None for r in receipts):
            whole = sum(r.facts[key] * share for r, share in zip(receipts, shares, strict=True))
            facts[key] = round(whole) if key in ("work", "raw_bytes") else round(whole, 4)
        else:
            facts.pop(key, None)  # of the first alone it is that of no share
    if all(r.facts.get("modules") for r in receipts):
        names = dict.fromkeys(name for r in receipts for name in r.facts["modules"])
        facts["modules"] = {
            name: round(
                sum(r.facts["modules"].get(name, 0.0) * share for r, share in zip(receipts, shares, strict=True)), 6
            )
            for name in names
        }
    return facts | {"resharded_from": old.grid.length}


def _side(sequence: SequenceGroup, which: str) -> Path:
    """Where the new sequence, or the old one, lies beside the sequence. Raises Unsafe where a link leads elsewhere."""
    return Archive(sequence.root.parent).place(f"{RESHARD}/{which}/{sequence.name}")


def switch(sequence: SequenceGroup) -> None:
    """Put the new sequence in the old one's place."""
    new, old = _side(sequence, "new"), _side(sequence, "old")
    shutil.rmtree(old, ignore_errors=True)
    make_folder(old.parent)
    for folder in [new, new.parent, old.parent, old.parent.parent]:
        sync_folder(folder)
    os.rename(sequence.root, old)
    os.rename(new, sequence.root)
    sync_folder(sequence.root.parent)
    shutil.rmtree(old)


def leftovers(sequence: SequenceGroup) -> list[Path]:
    """Folders of a reshard that did not come to its end; none holds anything that the sequence lacks."""
    return [p for p in (_side(sequence, "new"), _side(sequence, "old")) if p.is_dir()]
