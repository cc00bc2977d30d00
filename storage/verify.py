"""Reading again what receipts promise: every file's size and checksum, every array's decoded content.

Nothing here changes data. `repair` removes receipts, so that the next run makes their outputs anew, and deletes what
killed writers left over.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import zarr

from storage.archive import Sequence
from storage.lease import Lease, living
from storage.receipts import Output, Receipt, ReceiptKey, ShardFile, lease_file, read_receipt, remove_receipt
from storage.shards import table_digest
from storage.spec import array_digest

LEFT_OVER = "left over by a killed writer"
RECEIPT_UNREADABLE = "its receipt cannot be read"


@dataclass(frozen=True)
class Fault:
    """One thing that is not as promised."""

    cause: str
    """Missing, emptied, truncated, ..., in words."""
    file: str
    """Path below the sequence's folder."""
    output: Output | None = None
    """The output the file belongs to; None for receipts and left-overs."""
    receipt: Receipt | None = None
    """The receipt that promises it; None for receipts that cannot be read and for left-overs."""


@dataclass
class Count:
    """What was read."""

    files: int = 0
    bytes: int = 0
    busy: list[str] = field(default_factory=list)
    """Leases of tasks that were left out because a run works on them."""


def faults(sequence: Sequence, count: Count) -> Iterator[Fault]:
    """All faults of one sequence. Outputs that were dropped have nothing to verify; tasks that a run works on are left out."""
    busy = {file for file, _ in living(sequence.receipts)}
    count.busy += [file.relative_to(sequence.receipts).as_posix() for file in sorted(busy)]
    for file in sorted(sequence.receipts.rglob("*.json")):
        if file.with_suffix(".lease") in busy:
            continue
        try:
            receipt = Receipt.from_json(file.read_bytes())
        except FileNotFoundError:
            continue  # a run that began meanwhile removed it
        except (ValueError, KeyError, TypeError, OSError):
            yield Fault(RECEIPT_UNREADABLE, file.relative_to(sequence.root).as_posix())
            continue
        found = [f for output in receipt.outputs if not output.dropped for f in _of_output(sequence, receipt, output, count)]
        if found and read_receipt(sequence, key_of(receipt)) == receipt:  # else a run made it anew meanwhile
            yield from found
    if not busy:
        yield from (Fault(LEFT_OVER, p.relative_to(sequence.root).as_posix()) for p in sorted(sequence.root.rglob("*.partial")) if p.is_file())


def key_of(receipt: Receipt) -> ReceiptKey:
    """Which task a receipt is about."""
    return ReceiptKey(receipt.stage, receipt.partition, receipt.view, receipt.path)


def _of_output(sequence: Sequence, receipt: Receipt, output: Output, count: Count) -> list[Fault]:
    """Faults of the files of one output; of its content only where every file is as promised."""
    causes = [(f, _of_file(sequence.root / f.key, f)) for f in output.files]
    count.files += len(output.files)
    count.bytes += sum(f.size for f in output.files)
    found = [Fault(cause, f.key, output, receipt) for f, cause in causes if cause is not None]
    if not found and (cause := _of_content(sequence, receipt, output)) is not None:
        found.append(Fault(cause, output.array, output, receipt))
    return found


def _of_file(path: Path, promised: ShardFile) -> str | None:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return "missing"
    except OSError as e:
        return f"cannot be read ({e.strerror or e})"
    if not data:
        return "emptied"
    if len(data) < promised.size:
        return f"truncated to {len(data)} of {promised.size} bytes"
    if len(data) > promised.size:
        return f"grown to {len(data)} from {promised.size} bytes"
    return None if zlib.crc32(data) == promised.crc32 else "bits changed: the checksum is not the promised one"


def _of_content(sequence: Sequence, receipt: Receipt, output: Output) -> str | None:
    """Decode and compare with the content digest."""
    files = [sequence.root / f.key for f in output.files]
    try:
        if all(f.suffix == ".parquet" for f in files):
            found = table_digest(pq.read_table(files[0]).to_pydict())
        else:
            block = _block(sequence, receipt, output)
            if block is None:
                return None
            found = array_digest(block)
    except Exception as e:  # a broken array record or codec may raise anything; whatever it is, this output cannot be read
        return f"does not decode ({type(e).__name__}: {e})"
    return None if found == output.digest else "its content is not the promised one"


def _block(sequence: Sequence, receipt: Receipt, output: Output) -> np.ndarray | None:
    """The block as it was written; None where the array was cut or grown since, so that it cannot be read back whole."""
    array = zarr.open_array(sequence.root / output.array, mode="r")
    dims: tuple[str | None, ...] = getattr(array.metadata, "dimension_names", None) or ()
    index: list[slice | int] = []
    for dim, length, shard in zip(dims, array.shape, array.shards or array.chunks, strict=True):
        if dim == "frame":
            assert receipt.partition is not None, f"{output.array} has frames, its receipt no partition"
            start = receipt.partition * shard
            frames = len(receipt.parts["bounds"][0])
            if frames != min(shard, length - start):
                return None
            index.append(slice(start, start + frames))
        else:
            index.append(output.view if dim == "view" and output.view is not None else slice(None))
    return np.asarray(array[tuple(index)])


def repair(sequence: Sequence, fault: Fault) -> None:
    """Have the next run make anew what is broken. Raises LeaseHeld when a run works on it."""
    file = sequence.root / fault.file
    if fault.receipt is None:
        file.unlink(missing_ok=True)
        return
    key = key_of(fault.receipt)
    with Lease.take(lease_file(sequence, key), f"verify of process {os.getpid()}"):
        if read_receipt(sequence, key) == fault.receipt:
            remove_receipt(sequence, *key)
    assert fault.output is not None
    record = sequence.root / fault.output.array / "zarr.json"
    if record.is_file() and not _readable(record):
        record.unlink()  # the next run writes it anew


def _readable(record: Path) -> bool:
    try:
        return json.loads(record.read_bytes()).get("node_type") == "array"
    except (ValueError, AttributeError):
        return False
