"""Receipts: the only proof that a task's output is whole.

One JSON file a task, written atomically after every shard of the task is on disk, removed before the first shard of a
rerun is touched. So a death at any moment leaves a receipt that is true, or none.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from storage.archive import Sequence
from storage.files import refusals, sync_folder, write_atomically


@dataclass(frozen=True)
class ShardFile:
    """One file of an output."""

    key: str
    """Path below the sequence's folder."""
    size: int
    """Bytes."""
    crc32: int
    """CRC-32 of the file, for `verify`."""


@dataclass(frozen=True)
class Output:
    """One (array, partition, view) of a task."""

    array: str
    """Name of the array or table, its path filled in."""
    view: int | None
    """Index of the view, or None."""
    digest: str
    """BLAKE2b over dtype, shape and decoded bytes: equal content, equal digest."""
    files: tuple[ShardFile, ...]
    """The files that hold it, or held it where it was dropped."""
    dropped: bool = False
    """Whether the bytes were given up to save space: the digest still holds, so that what was made from them stays fresh."""


@dataclass(frozen=True)
class Receipt:
    """What one task made, from what, and how."""

    stage: str
    """Name of the stage."""
    partition: int | None
    """Number of the partition, or None for a task of the whole sequence."""
    view: int | None
    """Index of the view of a task over views."""
    path: str | None
    """Camera path of a task over paths."""
    fingerprint: str
    """Digest of `parts`."""
    parts: dict[str, Any]
    """Everything that went into the fingerprint, so that a plan can say what changed."""
    outputs: tuple[Output, ...]
    """What was written."""
    warnings: tuple[str, ...] = ()
    """Sentences of the stage's checks."""
    facts: dict[str, Any] = field(default_factory=dict)
    """Seconds, host, worker, device, threads, library versions: never part of the fingerprint."""

    @property
    def contents(self) -> dict[tuple[str, int | None], str]:
        """{(array, view): content digest} of all outputs, dropped ones too."""
        return {(o.array, o.view): o.digest for o in self.outputs}

    @property
    def present(self) -> dict[tuple[str, int | None], str]:
        """{(array, view): content digest} of the outputs whose bytes are there."""
        return {(o.array, o.view): o.digest for o in self.outputs if not o.dropped}

    def to_json(self) -> bytes:
        """UTF-8 JSON; `from_json` is the inverse."""
        return json.dumps(asdict(self), sort_keys=True).encode()

    @classmethod
    def from_json(cls, text: bytes) -> Receipt:
        """Parse; ValueError, KeyError or TypeError for what is not a receipt."""
        d = json.loads(text)
        if not isinstance(d, dict):
            raise TypeError(f"a receipt is a JSON object, this is a {type(d).__name__}")
        outputs = tuple(Output(o["array"], o["view"], o["digest"], tuple(ShardFile(**f) for f in o["files"]), o.get("dropped", False)) for o in d.pop("outputs"))
        return cls(**{**d, "outputs": outputs, "warnings": tuple(d["warnings"])})


class ReceiptKey(NamedTuple):
    """Which task a receipt is about, within its sequence."""

    stage: str
    """Name of the stage."""
    partition: int | None
    """Number of the partition."""
    view: int | None
    """Index of the view."""
    path: str | None
    """Camera path."""


def receipt_file(sequence: Sequence, stage: str, partition: int | None, view: int | None, path: str | None) -> Path:
    """Where a task's receipt lies."""
    parts = [stage, *([path] if path is not None else []), *([f"v{view:03d}"] if view is not None else [])]
    return sequence.receipts.joinpath(*parts, f"{'all' if partition is None else f'p{partition:06d}'}.json")


def lease_file(sequence: Sequence, key: ReceiptKey) -> Path:
    """Where the lease of a task lies: beside its receipt."""
    return receipt_file(sequence, *key).with_suffix(".lease")


def read_receipt(sequence: Sequence, key: ReceiptKey) -> Receipt | None:
    """One receipt; None when there is none or it cannot be read."""
    try:
        return Receipt.from_json(receipt_file(sequence, *key).read_bytes())
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_receipt(sequence: Sequence, receipt: Receipt) -> None:
    """Write atomically and sync: the last act of a task."""
    write_atomically(receipt_file(sequence, receipt.stage, receipt.partition, receipt.view, receipt.path), receipt.to_json())


def remove_receipt(sequence: Sequence, stage: str, partition: int | None, view: int | None, path: str | None) -> None:
    """Remove and sync: the first act of a task, so that new bytes never lie under an old receipt."""
    file = receipt_file(sequence, stage, partition, view, path)
    if file.exists():
        with refusals(file):
            file.unlink()
            sync_folder(file.parent)


def scan_receipts(sequence: Sequence) -> Iterator[Receipt]:
    """All readable receipts. One that cannot be parsed proves nothing, one that a running task just removed is gone: both are absent."""
    # plain paths: with ten thousand receipts half the time of a plan would go into Path objects
    for folder, folders, names in os.walk(sequence.receipts):
        folders.sort()
        for name in sorted(names):
            if not name.endswith(".json"):
                continue
            try:
                with open(f"{folder}/{name}", "rb") as f:
                    yield Receipt.from_json(f.read())
            except (ValueError, KeyError, TypeError, FileNotFoundError):
                continue


def missing_files(sequence: Sequence, receipt: Receipt) -> list[str]:
    """Keys of shards that are gone or of another size than the receipt says; dropped outputs have none to miss."""
    bad, root = [], str(sequence.root)
    for output in receipt.outputs:
        if output.dropped:
            continue
        for f in output.files:
            try:
                size = os.stat(f"{root}/{f.key}").st_size
            except OSError:
                size = -1
            if size != f.size:
                bad.append(f.key)
    return bad


def damaged_files(sequence: Sequence, receipt: Receipt) -> list[str]:
    """Keys of shards that are gone, or whose bytes are not those the receipt describes. Reads every file of the outputs that were not dropped."""
    bad = []
    for f in (f for output in receipt.outputs if not output.dropped for f in output.files):
        try:
            data = (sequence.root / f.key).read_bytes()
        except OSError:
            data = b""
        if (len(data), zlib.crc32(data)) != (f.size, f.crc32):
            bad.append(f.key)
    return bad
