"""Receipts: the only proof that a task's output is whole.

One JSON file a task, written atomically after every shard of the task is on disk, removed before the first shard of a
rerun is touched. So a death at any moment leaves a receipt that is true, or none.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posegaussian.storage.archive import checksums
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import FileSizes, Unsafe, files_below, is_word, parse_json, read_file
from posegaussian.storage.files.write import refusals, sync_folder, write_atomically

MOST_BYTES = 2**26
"""Bytes of a receipt: what a survey notes is in it."""

MOST_SHARD_BYTES = 2**34
"""Bytes of one file of an output."""

MOST_NUMBER = 2**31
"""Largest number of a partition or a view."""

_KEY = re.compile(r"c((/[0-9]{1,10})*|(\.[0-9]{1,10})*)|(all|p[0-9]{6,10})\.parquet")
"""What follows an array's or a table's name in the key of a file: a shard's place, or a partition of a table."""

NUMBERS = ("seconds", "warm_up", "cpu_seconds", "work", "raw_bytes", "peak_rss", "projected_ram")
"""Facts that are counted together."""

TEXTS = ("unit", "started", "host", "worker", "device", "run", "token")
"""Facts that are names."""


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
    """Whether the bytes were given up to save space:
    the digest still holds, so that what was made from them stays fresh."""


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
        """UTF-8 JSON with a checksum; `from_json` is the inverse."""
        return checksums.sealed_text(json.dumps(asdict(self), sort_keys=True).encode())

    @classmethod
    def from_json(cls, text: bytes) -> Receipt:
        """Parse; ValueError, KeyError or TypeError for what is not a receipt or is not what its checksum was taken of.

        Raises Unsafe for names that no task has: they would lead to files of others.
        """
        d = parse_json(text)
        if not isinstance(d, dict):
            raise TypeError(f"a receipt is a JSON object, this is a {type(d).__name__}")
        if d.pop(checksums.KEY, None) is not None and checksums.text_changed(text):
            raise ValueError("it is not what its checksum was taken of")
        outputs = tuple(
            Output(
                o["array"], o["view"], o["digest"], tuple(ShardFile(**f) for f in o["files"]), o.get("dropped", False)
            )
            for o in d.pop("outputs")
        )
        receipt = cls(**{**d, "outputs": outputs, "warnings": tuple(d["warnings"])})
        _check_names(receipt)
        _check_types(receipt)
        return receipt


def _check_names(receipt: Receipt) -> None:
    """Raise Unsafe for a stage, path, array or file key that no task writes:
    absolute, climbing, or of something else."""
    for name, what in ((receipt.stage, "stage"), (receipt.path, "path")):
        if not is_word(name) and (what == "stage" or name is not None):
            raise Unsafe(f"{what} {_shown(name)} is no name")
    for output in receipt.outputs:
        if not isinstance(output.array, str) or not _is_array(output.array):
            raise Unsafe(f"array {_shown(output.array)} is no name of an array")
        start = f"{output.array}/"
        for f in output.files:
            if not isinstance(f.key, str) or not f.key.startswith(start) or _KEY.fullmatch(f.key, len(start)) is None:
                raise Unsafe(f"file {_shown(f.key)} is none of array {output.array}")


@lru_cache(maxsize=4096)
def _is_array(name: str) -> bool:
    return all(is_word(part) for part in name.split("/"))


def _shown(value: Any) -> str:
    return repr(value) if len(repr(value)) <= 120 else f"{value!r:.117}..."


def _check_types(receipt: Receipt) -> None:
    """Raise TypeError for entries that are not of the type everybody counts on."""
    for n in (receipt.partition, receipt.view, *[o.view for o in receipt.outputs]):
        if n is not None and (type(n) is not int or not 0 <= n < MOST_NUMBER):
            raise TypeError("a partition or a view is no whole number")
    for o in receipt.outputs:
        for f in o.files:
            if type(f.size) is not int or type(f.crc32) is not int or f.size < 0:
                raise TypeError("a size or a checksum is no whole number")
    if not all(
        isinstance(t, str) for t in (receipt.fingerprint, *receipt.warnings, *(o.digest for o in receipt.outputs))
    ) or not all(isinstance(o.dropped, bool) for o in receipt.outputs):
        raise TypeError("a fingerprint, digest or warning is no text")
    _check_parts(receipt.parts)
    _check_facts(receipt.facts)


def _check_parts(parts: dict[str, Any]) -> None:
    """Raise TypeError for fingerprint parts that cannot be compared with others."""
    if not isinstance(parts, dict) or not all(
        isinstance(parts.get(k, {}), dict) for k in ("params", "effects", "sources", "inputs")
    ):
        raise TypeError("parts are no object")
    lists = (parts.get("asked", []), parts.get("bounds", []))
    if not all(isinstance(n, list) for n in (*lists, *lists[1][:1])) or not all(isinstance(n, str) for n in lists[0]):
        raise TypeError("bounds or what was asked for are no list")


def _check_facts(facts: dict[str, Any]) -> None:
    """Raise TypeError and ValueError for facts that cannot be counted, and for notes that are no arrays of numbers."""
    if (
        not isinstance(facts, dict)
        or not all(isinstance(facts.get(k) or {}, dict) for k in ("modules", "noted"))
        or not isinstance(facts.get("accepted", []), list)
    ):
        raise TypeError("facts are no object")
    counted = [*(facts.get(k) for k in NUMBERS), *(facts.get("modules") or {}).values()]
    if not all(n is None or (type(n) in (int, float) and abs(n) < 2**62) for n in counted):
        raise TypeError("a fact is no number")
    if not all(facts.get(k) is None or isinstance(facts[k], str) for k in TEXTS):
        raise TypeError("a fact is no text")
    for values in (facts.get("noted") or {}).values():
        if np.asarray(values).dtype.kind not in "biuf":
            raise TypeError("a note is no array of numbers")


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


def receipt_file(
    sequence: SequenceGroup, stage: str, partition: int | None, view: int | None, path: str | None
) -> Path:
    """Where a task's receipt lies. Raises Unsafe where a link lies on the way."""
    parts = ["_receipts", stage, *([path] if path is not None else []), *([f"v{view:03d}"] if view is not None else [])]
    return sequence.place("/".join([*parts, f"{'all' if partition is None else f'p{partition:06d}'}.json"]))


def lease_file(sequence: SequenceGroup, key: ReceiptKey) -> Path:
    """Where the lease of a task lies: beside its receipt."""
    return receipt_file(sequence, *key).with_suffix(".lease")


def load_receipt(file: Path | str) -> Receipt:
    """The receipt in a file, checked: the one way to read one.

    Raises ValueError, KeyError or TypeError for what is not a receipt, OSError, and Unsafe, with what to do, for names
    in it that would lead to files of others.
    """
    try:
        return Receipt.from_json(read_file(file, MOST_BYTES))
    except Unsafe as e:
        raise (
            e
            if str(file) in str(e)
            else Unsafe(
                f"receipt {file}: {e}; it was not made by posegaussian, so nothing is read, written or deleted by it:"
                " `posegaussian verify --repair` removes it"
            )
        ) from None


def read_receipt(sequence: SequenceGroup, key: ReceiptKey) -> Receipt | None:
    """One receipt; None when there is none or it cannot be read. Raises Unsafe."""
    try:
        return load_receipt(receipt_file(sequence, *key))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_receipt(sequence: SequenceGroup, receipt: Receipt) -> None:
    """Write atomically and sync: the last act of a task."""
    write_atomically(
        receipt_file(sequence, receipt.stage, receipt.partition, receipt.view, receipt.path), receipt.to_json()
    )


def remove_receipt(
    sequence: SequenceGroup, stage: str, partition: int | None, view: int | None, path: str | None
) -> None:
    """Remove and sync: the first act of a task, so that new bytes never lie under an old receipt."""
    file = receipt_file(sequence, stage, partition, view, path)
    if file.exists():
        with refusals(file):
            file.unlink()
            sync_folder(file.parent)


def has_receipts(sequence: SequenceGroup) -> bool:
    """Whether a sequence has any receipt, readable or not. Raises Unsafe as `scan_receipts`."""
    return any(file.endswith(".json") for file in files_below(sequence.receipts))


def scan_receipts(sequence: SequenceGroup) -> Iterator[Receipt]:
    """All readable receipts. One that cannot be parsed proves nothing, one that a running task just removed is gone:
    both are absent.

    Raises Unsafe for names and links that would lead out of the archive.
    """
    for file in files_below(sequence.receipts):
        if file.endswith(".json"):
            try:
                yield load_receipt(file)
            except (ValueError, KeyError, TypeError, FileNotFoundError):
                continue


def missing_files(sequence: SequenceGroup, receipt: Receipt, look: FileSizes | None = None) -> list[str]:
    """Keys of shards that are gone or of another size than the receipt says; dropped outputs have none to miss.

    `look`: one for many receipts of the sequence. Raises Unsafe where a link lies on the way to a shard.
    """
    look = look or FileSizes(sequence.root)
    return [
        f.key for output in receipt.outputs if not output.dropped for f in output.files if look.size(f.key) != f.size
    ]


def damaged_files(sequence: SequenceGroup, receipt: Receipt) -> list[str]:
    """Keys of shards that are gone, or whose bytes are not those the receipt describes. Reads every file of the
    outputs that were not dropped."""
    bad = []
    for f in (f for output in receipt.outputs if not output.dropped for f in output.files):
        try:
            data = read_shard(sequence, f.key)
        except OSError:
            data = b""
        if (len(data), zlib.crc32(data)) != (f.size, f.crc32):
            bad.append(f.key)
    return bad


def read_shard(sequence: SequenceGroup, key: str) -> bytes:
    """The bytes of one file of an output. Raises OSError, and Unsafe where a link lies on the way or in its place."""
    return read_file(sequence.place(key), MOST_SHARD_BYTES)
