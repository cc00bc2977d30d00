"""What may be deleted and how: in an order that a death at any moment makes harmless.

A receipt changes or goes before the files it speaks of, so a receipt never promises what is no longer there. Files that
no receipt names are then left over at worst, and `strays` finds them.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import time
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from uuid import uuid4

from posegaussian.storage.archive.lease import Lease, own_name
from posegaussian.storage.archive.receipts import (
    Receipt,
    ReceiptKey,
    ShardFile,
    lease_file,
    read_receipt,
    receipt_file,
    remove_receipt,
    write_receipt,
)
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import files_below, refuse_link, refuse_links
from posegaussian.storage.files.write import sync_folder
from posegaussian.storage.model.errors import LeaseHeld

SETTLED_SECONDS = 600.0
"""Files younger than this may belong to a task that is at work: they are never swept up."""


def bytes_of(files: Iterable[ShardFile]) -> int:
    """Bytes that shards take on disk, by their receipts."""
    return sum(f.size for f in files)


def drop_outputs(sequence: SequenceGroup, receipt: Receipt, chosen: Collection[tuple[str, int | None]]) -> Receipt:
    """Give up the bytes of some (array, view) of a task; its receipt keeps their digests and says that they are
    dropped.

    Returns the receipt as it is on disk afterwards. Nothing is done where another run makes the task anew, or has done
    so. A reader that began before finds at its end that its input is no longer present, and fails instead of having
    read zeros.
    """
    key = ReceiptKey(receipt.stage, receipt.partition, receipt.view, receipt.path)
    try:
        with Lease.take(lease_file(sequence, key), own_name("sweep")):
            return _drop(sequence, key, receipt, chosen)
    except LeaseHeld:
        return receipt


def _drop(
    sequence: SequenceGroup, key: ReceiptKey, receipt: Receipt, chosen: Collection[tuple[str, int | None]]
) -> Receipt:
    now = read_receipt(sequence, key)
    if now is None or now.fingerprint != receipt.fingerprint or now.contents != receipt.contents:
        return receipt
    going = [o for o in now.outputs if (o.array, o.view) in chosen and not o.dropped]
    if not going:
        return now
    marked = dataclasses.replace(
        now, outputs=tuple(dataclasses.replace(o, dropped=o.dropped or o in going) for o in now.outputs)
    )
    places = {f.key: sequence.place(f.key) for o in going for f in o.files}
    write_receipt(sequence, marked)
    for name, file in places.items():
        file.unlink(missing_ok=True)
        _remove_empty(file.parent, _partition_folder(sequence, name))
    return marked


def _partition_folder(sequence: SequenceGroup, key: str) -> Path:
    """The folder of a shard that other tasks may be writing into, so that a run leaves it: the array's, or
    `<array>/c/<partition>` of arrays of earlier versions."""
    array, nested, rest = key.partition("/c/")
    return sequence.root / array / "c" / rest.partition("/")[0] if nested else (sequence.root / key).parent


def forget(sequence: SequenceGroup, receipt: Receipt) -> None:
    """Delete a task's receipt, then its outputs.
    Raises Unsafe, with nothing deleted, where a link lies on the way to one."""
    files = [sequence.place(f.key) for o in receipt.outputs for f in o.files]
    remove_receipt(sequence, receipt.stage, receipt.partition, receipt.view, receipt.path)
    delete_files(files)
    _remove_empty(
        receipt_file(sequence, receipt.stage, receipt.partition, receipt.view, receipt.path).parent, sequence.receipts
    )


def delete_files(files: Iterable[Path]) -> None:
    """Delete files that may already be gone, and the folders of shards that become empty; no run may be at work."""
    folders = set()
    for file in files:
        file.unlink(missing_ok=True)
        folders.add(file.parent)
    for folder in folders:
        _remove_empty(folder, None)


def _remove_empty(folder: Path, stop: Path | None) -> None:
    """Remove a folder and those above it, below `stop`, while they are empty; an array's own folder holds its
    zarr.json and stays."""
    while folder != stop and folder != folder.parent:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent


def delete_folder(folder: Path) -> None:
    """Delete a folder with all it holds; its name goes first, so that a half deleted one is not taken for whole.

    Links in it are deleted and not followed; Unsafe is raised for one in its place.
    """
    if not os.path.lexists(folder):
        return
    refuse_link(str(folder), folder.lstat().st_mode)
    grave = folder.with_name(f".{folder.name}.{uuid4().hex}.partial")
    folder.rename(grave)
    sync_folder(folder.parent)
    shutil.rmtree(grave)


def folder_bytes(folder: Path) -> int:
    """Bytes of all files below a folder. Raises Unsafe for a link among them."""
    return sum(os.lstat(p).st_size for p in files_below(folder))


def settled(path: Path) -> bool:
    """Whether a file or folder has not been written for a while; a file that just went counts as not settled."""
    try:
        return time.time() - path.stat().st_mtime > SETTLED_SECONDS
    except FileNotFoundError:
        return False


def partial_files(root: Path) -> list[Path]:
    """Files and folders that a killed writer or a killed sweep left half done, outermost first.
    Raises Unsafe for a link anywhere."""
    found: list[Path] = []
    refuse_links(root)
    for p in sorted(root.rglob("*.partial")):
        if settled(p) and not any(f in p.parents for f in found):
            found.append(p)
    return found


def strays(sequence: SequenceGroup, receipts: Iterable[Receipt], arrays: Collection[str]) -> Iterator[Path]:
    """Shards and tables of the given arrays that no receipt names:
    unfinished work, or what a killed sweep left. Raises Unsafe."""
    named = {f.key for r in receipts for o in r.outputs if not o.dropped for f in o.files}
    for array in sorted(arrays):
        folder = sequence.place(array)
        for file in sorted([*map(Path, files_below(folder / "c")), *folder.glob("c.*"), *folder.glob("*.parquet")]):
            if file.is_symlink():
                refuse_link(str(file), file.lstat().st_mode)
            key = file.relative_to(sequence.root).as_posix()
            if file.is_file() and key not in named and file.suffix != ".partial" and settled(file):
                yield file
