"""Variants: the same sequence under other settings, beside the user's results and never in them.

A variant is an archive of its own, `<archive>/_variants/<hash of what differs>`, with a folder of the same sequence.
What a variant would make with an equal fingerprint is not made again: its receipt is copied and its shards are hard
links (copies where the file system has none). A shard is replaced by unlinking it and writing a new file, never in
place, so neither side can change the other's bytes.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Iterable
from typing import Any, TypeAlias

from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.fingerprint import still_good
from posegaussian.dags.planning.plan import Plan, State, judge, make_plan, of_other_pictures, pictures_digest
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task, tasks_of
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.array_metadata import copy_description
from posegaussian.storage.archive.chunk_keys import named_as_in
from posegaussian.storage.archive.receipts import (
    Receipt,
    ReceiptKey,
    missing_files,
    read_receipt,
    remove_receipt,
    scan_receipts,
    write_receipt,
)
from posegaussian.storage.archive.records import record_text
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.files.names import folders_in
from posegaussian.storage.files.write import link_or_copy, link_tree, write_atomically
from posegaussian.storage.model.errors import BrokenRecord
from posegaussian.storage.model.spec import digest

FOLDER = "_variants"
"""Folder of all variants below the archive's."""
Made: TypeAlias = defaultdict[Task, list[tuple[SequenceGroup, Receipt]]]
"""What was made of each task, and where."""


def variant(
    origin: SequenceGroup,
    settings: Any,
    different: dict[str, Any],
    paths: tuple[str, ...],
    partition_frames: int | None = None,
) -> Context:
    """The context of a sequence's variant, made or found again.

    Args:
        origin: the user's sequence; its record is taken over, nothing of it is changed.
        settings: all settings of the variant.
        different: {stage.key: value} of what sets it apart; with the partitions' length it names the folder.
        paths: camera paths to render.
        partition_frames: length of its partitions; None: as those of the sequence.
    """
    beside, record = Archive(origin.root.parent), origin.place("zarr.json").read_bytes()
    if partition_frames not in (None, origin.partition_frames):
        different = {**different, "partition_frames": partition_frames}
        record = record_text({**origin.record, "partition_frames": partition_frames}, {})
    archive = Archive.open(str(beside.place(f"{FOLDER}/{digest(different)[:12]}")), create=True)
    root, file = archive.place(origin.name), archive.place(f"{origin.name}/zarr.json")
    if not file.is_file() or file.read_bytes() != record:
        write_atomically(file, record)
        link_tree(origin.place("source"), archive.place(f"{origin.name}/source"))
    return make_context(SequenceGroup(root), settings, paths)


def settled_variant(
    origin: SequenceGroup,
    settings: Any,
    different: dict[str, Any],
    paths: tuple[str, ...],
    partition_frames: int | None = None,
) -> Context:
    """A variant that has taken over all it can; what a survey says may settle more, so the context is made until
    nothing comes.

    Constants of other pictures than the capture has now are not its own any more: the user's sequence keeps them until
    it is told otherwise, but nobody can tell a variant, and a new one would not take them over.
    """
    _forget_other_pictures(variant(origin, settings, different, paths, partition_frames))
    while True:
        context = variant(origin, settings, different, paths, partition_frames)
        if not share(context, others(origin)):
            return context


def _forget_other_pictures(context: Context) -> None:
    """Remove the receipts of a variant's constants that were taken of other pictures than the capture has now."""
    for stage in (s for s in STAGES if s.sequence_wide):
        for task in tasks_of(context, stage):
            receipt = read_receipt(context.sequence, ReceiptKey(*task[1:]))
            if receipt is not None and of_other_pictures(context, task, receipt):
                remove_receipt(context.sequence, *task[1:])


def variants(archive: Archive) -> list[Archive]:
    """The archives of all variants of an archive's sequences."""
    return [Archive(folder) for folder in folders_in(archive.place(FOLDER))]


def others(origin: SequenceGroup) -> list[SequenceGroup]:
    """The sequence itself and all its variants: where equal outputs may be found."""
    beside = variants(Archive(origin.root.parent))
    return [
        origin,
        *(SequenceGroup(v.place(origin.name)) for v in beside if v.place(f"{origin.name}/zarr.json").is_file()),
    ]


def share(context: Context, sources: Iterable[SequenceGroup]) -> int:
    """Take over every output that some source made with the fingerprint it would have here; returns how many tasks.

    Tasks are looked at in the order of flow, because a fingerprint holds the contents of what the task reads. Constants
    of the sequence that were taken together with more than is asked for here will do. Outputs whose files are not all
    there, or were dropped, are not taken, nor are those of a sequence in partitions of another length, whose shards are
    of other frames.
    """
    here = context.sequence
    found: Made = defaultdict(list)
    for source in sources:
        if source.root == here.root or not _of_length(source, here.partition_frames):
            continue
        for r in scan_receipts(source):
            found[Task(here.name, r.stage, r.partition, r.view, r.path)].append((source, r))
    total = 0
    while taken := _take_equal(
        make_plan(context), found
    ):  # what a survey says may decide what the next ones are compared with
        total += taken
    return total


def _of_length(source: SequenceGroup, frames: int) -> bool:
    """Whether the partitions of a sequence have so many frames; not where another process deleted it meanwhile."""
    try:
        return source.partition_frames == frames
    except BrokenRecord:
        return False


def _take_equal(plan: Plan, found: Made) -> int:
    """Take over what a plan would make and somebody has made; returns how many tasks."""
    taken = 0
    for task, verdict in plan.verdicts.items():
        digests = plan.book.digests(task)
        if verdict.state is State.FRESH or digests is None:
            continue
        state, _, parts = judge(plan.book, task, Selection(), digests)
        match = next((m for m in found.get(task, ()) if _will_do(plan.context, task, parts, m[1])), None)
        if state is State.FRESH or match is None or missing_files(*match):
            continue
        try:
            plan.book.add(task, _take(plan.context.sequence, *match))
        except OSError:
            if not missing_files(*match):
                raise
            continue  # another process deleted the variant meanwhile
        taken += 1
    return taken


def _will_do(context: Context, task: Task, parts: dict[str, Any], receipt: Receipt) -> bool:
    """Whether a receipt is of what a task with these fingerprint parts would make; of constants, which do not depend on
    the sources, whether they were taken of the same pictures, too."""
    if any(o.dropped for o in receipt.outputs):
        return False
    if not stage_named(task.stage).sequence_wide:
        return receipt.fingerprint == digest(parts)
    as_kept = still_good(parts, receipt.parts)
    same = receipt.parts == as_kept or receipt.fingerprint == digest(as_kept)
    return same and receipt.facts.get("sources") == pictures_digest(context, task)


def _take(here: SequenceGroup, source: SequenceGroup, receipt: Receipt) -> Receipt:
    """Copy what describes a task's arrays, link its shards, and last write the receipt, which is returned."""
    for array in dict.fromkeys(o.array for o in receipt.outputs):
        with contextlib.suppress(FileNotFoundError):  # a table has no description
            copy_description(source.place(array), here.place(array))
    own = named_as_in(here, receipt)
    for there, output in zip(receipt.outputs, own.outputs, strict=True):
        for old, new in zip(there.files, output.files, strict=True):
            link_or_copy(source.place(old.key), here.place(new.key))
    write_receipt(here, own)
    return own
