"""Results of other settings, put aside before they are replaced, so that going back to a setting takes them over.

Beside the sequences of an archive lies `_kept/<sequence>/<task and fingerprint>/`: the receipt of a task and hard links
to its shards. A shard is never written in place, so a link costs a name and no bytes until the sequence's own is
replaced. An entry takes its name when it is whole; it is a cache, and whatever is wrong with it means that it is not
there.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import time
import zlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from uuid import uuid4

from posegaussian.storage.archive.array_metadata import read_metadata
from posegaussian.storage.archive.chunk_keys import named_as_in
from posegaussian.storage.archive.deletion import SETTLED_SECONDS, delete_folder
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import (
    MOST_BYTES,
    MOST_SHARD_BYTES,
    Receipt,
    ReceiptKey,
    lease_file,
    remove_receipt,
    write_receipt,
)
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.files.names import files_below, folders_in, parse_json, read_file
from posegaussian.storage.files.write import PARTIAL, link_or_copy, sync_folder
from posegaussian.storage.model.errors import ArchiveError
from posegaussian.storage.model.spec import digest

FOLDER = "_kept"
"""Folder of what is put aside, below the archive's."""

ENTRY = "entry.json"
"""The receipt, and how the arrays of its shards are laid out."""


@dataclass(frozen=True)
class Entry:
    """One task's result that was put aside."""

    folder: Path
    """Where it lies."""
    used: float
    """When it was put aside or taken over last, seconds since the epoch."""
    worth: float
    """Seconds it took to make a byte of it: of equal age the cheaper goes first."""
    own: int
    """Bytes that nothing else links to."""


def key_of(receipt: Receipt) -> ReceiptKey:
    """The task of a receipt."""
    return ReceiptKey(receipt.stage, receipt.partition, receipt.view, receipt.path)


def _place(sequence: SequenceGroup, key: ReceiptKey, fingerprint: str) -> Path:
    return Archive(sequence.root.parent).place(f"{FOLDER}/{sequence.name}/{digest([*key, fingerprint])}")


def put(sequence: SequenceGroup, receipts: Iterable[Receipt]) -> bool:
    """Put whole results aside, all with the same time of use; False where the file system has no hard links: then
    nothing is kept."""
    now = time.time()
    for receipt in receipts:
        place = _place(sequence, key_of(receipt), receipt.fingerprint)
        if not (place / ENTRY).is_file():
            _delete(place)  # a kill may have left a part of an entry that was being deleted
            partial = place.with_name(f".{place.name}.{uuid4().hex}{PARTIAL}")
            partial.mkdir(parents=True)
            files = [f for output in receipt.outputs for f in output.files]
            layouts = {output.array: _layout(sequence, output.array) for output in receipt.outputs}
            try:
                for i, f in enumerate(files):
                    os.link(sequence.place(f.key), partial / str(i))
                (partial / ENTRY).write_bytes(
                    json.dumps({"receipt": receipt.to_json().decode(), "layouts": layouts}).encode()
                )
                os.rename(partial, place)
            except FileNotFoundError:  # another run replaces it now
                shutil.rmtree(partial, ignore_errors=True)
                continue
            except OSError:
                shutil.rmtree(partial, ignore_errors=True)
                if not (place / ENTRY).is_file():
                    return False
        os.utime(place / ENTRY, (now, now))
    return True


def _layout(sequence: SequenceGroup, array: str) -> str:
    """Digest of how an array's shards are laid out, its lengths along frames and views and the names of its shards
    left out; of a table nothing."""
    try:
        found = read_metadata(sequence.place(array))
    except FileNotFoundError:
        return ""
    dims = found.get("dimension_names") or []
    lengths = [n for d, n in zip(dims, found["shape"], strict=True) if d not in ("frame", "view")]
    return digest(
        [
            lengths,
            dims,
            *(json.dumps(found.get(k), sort_keys=True) for k in ("data_type", "chunk_grid", "codecs", "fill_value")),
        ]
    )


def find(sequence: SequenceGroup, key: ReceiptKey, fingerprint: str) -> Receipt | None:
    """The receipt of a result that was put aside and whose files have the right sizes; None where there is none."""
    return _read(sequence, key, fingerprint)[0]


def _read(sequence: SequenceGroup, key: ReceiptKey, fingerprint: str) -> tuple[Receipt | None, dict[str, str]]:
    place = _place(sequence, key, fingerprint)
    try:
        found = parse_json(read_file(place / ENTRY, MOST_BYTES))
        receipt = Receipt.from_json(found["receipt"].encode())
        files = [f for output in receipt.outputs for f in output.files]
        states = [os.lstat(place / str(i)) for i in range(len(files))]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ArchiveError):
        return None, {}
    whole = all(stat.S_ISREG(s.st_mode) and s.st_size == f.size for s, f in zip(states, files, strict=True))
    asked_for = key_of(receipt) == key and receipt.fingerprint == fingerprint
    return (receipt, found["layouts"]) if whole and asked_for else (None, {})


def take(sequence: SequenceGroup, key: ReceiptKey, fingerprint: str, run: str, seconds: float) -> Receipt | None:
    """Take a result over in the place of what the sequence has; its receipt, or None where there is none that is whole.

    The arrays must be there. The order is a task's: lease, old receipt removed, shards, receipt; a death in between
    leaves no receipt. Bytes are compared with their checksums first; what is damaged is deleted. Raises LeaseHeld.
    """
    receipt, layouts = _read(sequence, key, fingerprint)
    if receipt is None or any(layouts.get(o.array) != _layout(sequence, o.array) for o in receipt.outputs):
        return None
    place = _place(sequence, key, fingerprint)
    receipt = named_as_in(sequence, receipt)
    pairs = [(place / str(i), f) for i, f in enumerate(f for output in receipt.outputs for f in output.files)]
    try:
        if any(zlib.crc32(read_file(source, MOST_SHARD_BYTES)) != f.crc32 for source, f in pairs):
            forget(sequence, key, fingerprint)
            return None
        with Lease.take(lease_file(sequence, key), run, "driver", seconds) as lease:
            remove_receipt(sequence, *key)
            for source, f in pairs:
                lease.check()
                link_or_copy(source, sequence.place(f.key))
            for folder in {sequence.place(f.key).parent for _, f in pairs}:
                sync_folder(folder)
            lease.check()
            write_receipt(sequence, receipt)
        os.utime(place / ENTRY)
    except OSError:  # deleted by another run meanwhile, or a disk that takes nothing: computing says what is wrong
        return None
    return receipt


def forget(sequence: SequenceGroup, key: ReceiptKey, fingerprint: str) -> None:
    """Delete an entry, if there is one."""
    _delete(_place(sequence, key, fingerprint))


def _delete(folder: Path) -> None:
    """The description goes first: without it there is no entry."""
    (folder / ENTRY).unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


def entries(archive: Archive) -> list[Entry]:
    """All that is put aside, longest unused first."""
    found = []
    for folder in _folders(archive):
        try:
            used = os.lstat(folder / ENTRY).st_mtime
            receipt = Receipt.from_json(parse_json(read_file(folder / ENTRY, MOST_BYTES))["receipt"].encode())
            states = [os.lstat(p) for p in files_below(folder) if not p.endswith(f"/{ENTRY}")]
        except (OSError, ValueError, KeyError, TypeError, AttributeError, ArchiveError):
            continue  # another process deleted it, or it is none
        size = sum(s.st_size for s in states)
        found.append(
            Entry(
                folder,
                used,
                float(receipt.facts.get("seconds") or 0.0) / max(1, size),
                sum(s.st_size for s in states if s.st_nlink == 1),
            )
        )
    return sorted(found, key=lambda e: (e.used, e.worth, e.folder.name))


def _folders(archive: Archive) -> list[Path]:
    """Folders of all entries, whole or not. Raises Unsafe for a link among them."""
    return [entry for sequence in folders_in(archive.place(FOLDER)) for entry in folders_in(sequence)]


def shrink(archive: Archive, budget: int, take: Mapping[Path, int] = MappingProxyType({})) -> None:
    """Delete what was not used for the longest time until the rest fits into `budget` bytes.

    take: {folder: bytes} of entries that will take other bytes than now, as what they link to is replaced or taken
    over.
    """
    known = [(e.folder, take.get(e.folder, e.own)) for e in entries(archive)]
    total = sum(size for _, size in known)
    for folder, size in known:
        if total > budget and size:
            _delete(folder)
            total -= size
    _sweep(archive)


def clear(archive: Archive, names: Collection[str] | None = None) -> None:
    """Delete all that is put aside, or what is of some sequences."""
    for key in [FOLDER] if names is None else [f"{FOLDER}/{name}" for name in names]:
        delete_folder(archive.place(key))


def clear_sequence(archive: Archive, name: str) -> None:
    """Delete all that is put aside of one sequence. Raises Unsafe for a link in its folder's place."""
    delete_folder(archive.place(f"{FOLDER}/{name}"))


def _sweep(archive: Archive) -> None:
    """Delete what a kill left half made or half deleted, once it is surely nobody's."""
    old = time.time() - SETTLED_SECONDS
    for folder in _folders(archive):
        if not (folder / ENTRY).is_file() and folder.lstat().st_mtime < old:
            shutil.rmtree(folder, ignore_errors=True)


def place_of(sequence: SequenceGroup, receipt: Receipt) -> Path:
    """Where a result is or would be put aside."""
    return _place(sequence, key_of(receipt), receipt.fingerprint)
