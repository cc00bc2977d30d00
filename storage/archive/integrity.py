"""Reading again what receipts promise, every file's size and checksum, every array's decoded content; and the source
files that a run trusts while their size and time are those of the import.

Nothing here changes data. `repair` removes receipts, so that the next run makes their outputs anew, and deletes what
killed writers left over; `seal_all` adds the checksums that an archive of an earlier version lacks.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from posegaussian.storage.archive import checksums
from posegaussian.storage.archive.array_metadata import (
    ForeignArray,
    is_sealed,
    is_sharded,
    read_metadata,
    refuse_huge,
    seal,
    values_digest,
)
from posegaussian.storage.archive.chunk_keys import unpromised
from posegaussian.storage.archive.lease import Lease, living, own_name
from posegaussian.storage.archive.receipts import (
    Output,
    Receipt,
    ReceiptKey,
    ShardFile,
    lease_file,
    load_receipt,
    read_receipt,
    read_shard,
    remove_receipt,
)
from posegaussian.storage.archive.records import FILE, write_record
from posegaussian.storage.archive.shards import table_digest
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import Unsafe, files_below
from posegaussian.storage.model.errors import ArchiveError, ShardMissing, SourceError
from posegaussian.storage.model.spec import content_digest

LEFT_OVER = "left over by a killed writer"
RECEIPT_UNREADABLE = "its receipt cannot be read"
FOREIGN_RECEIPT = "it names what no task writes"
GIVEN = "truth/"
"""Arrays that come with a simulated capture: no run makes them."""
ARRAY_BROKEN = "an array that cannot be read as it was written"
SOURCE_CHANGED = "source file that is not what was imported"


@dataclass(frozen=True)
class Fault:
    """One thing that is not as promised."""

    cause: str
    """Missing, emptied, truncated, ..., in words."""
    file: str
    """Path below the sequence's folder; of a source file where it lies."""
    output: Output | None = None
    """The output the file belongs to; None for receipts and left-overs."""
    receipt: Receipt | None = None
    """The receipt that promises it; None for receipts that cannot be read, for left-overs and for source files."""

    @property
    def foreign(self) -> bool:
        """Whether no run makes the file: a repair leaves it alone."""
        return self.file.startswith(GIVEN) or self.cause.startswith(SOURCE_CHANGED)


@dataclass
class Count:
    """What was read."""

    files: int = 0
    bytes: int = 0
    sources: int = 0
    source_bytes: int = 0
    gone: list[str] = field(default_factory=list)
    """Source files that are not where they were imported from."""
    busy: list[str] = field(default_factory=list)
    """Leases of tasks that were left out because a run works on them."""
    unsealed: int = 0
    """Records and descriptions of arrays that have no checksum."""


def faults(sequence: SequenceGroup, count: Count) -> Iterator[Fault]:
    """All faults of one sequence. Outputs that were dropped have nothing to verify; tasks that a run works on are left
    out.

    Raises BrokenRecord where the sequence's own record changed, Unsafe where a link leads out of the archive.
    """
    count.unsealed += checksums.KEY not in sequence.record
    _ = sequence.capture
    busy = {file for file, _ in living(sequence.receipts)}
    leases = [file.relative_to(sequence.receipts).as_posix() for file in sorted(busy)]
    count.busy += [lease for lease in leases if not lease.startswith("_")]  # the others are of runs, and of arrays
    for file in (Path(f) for f in files_below(sequence.receipts) if f.endswith(".json")):
        if file.with_suffix(".lease") in busy:
            continue
        try:
            receipt = load_receipt(file)
        except FileNotFoundError:
            continue  # a run that began meanwhile removed it
        except Unsafe as e:
            yield Fault(f"{FOREIGN_RECEIPT} ({e})", file.relative_to(sequence.root).as_posix())
            continue
        except (ValueError, KeyError, TypeError, OSError):
            yield Fault(RECEIPT_UNREADABLE, file.relative_to(sequence.root).as_posix())
            continue
        found = [
            f for output in receipt.outputs if not output.dropped for f in _of_output(sequence, receipt, output, count)
        ]
        if found and read_receipt(sequence, key_of(receipt)) == receipt:  # else a run made it anew meanwhile
            yield from found
    yield from _arrays(sequence, count)
    yield from _sources(sequence, count)
    if not busy:
        yield from (
            Fault(LEFT_OVER, os.path.relpath(p, sequence.root))
            for p in files_below(sequence.root)
            if p.endswith(".partial")
        )


def _arrays(sequence: SequenceGroup, count: Count) -> Iterator[Fault]:
    """Faults of what no receipt speaks of:
    descriptions of arrays, and arrays that are written whole (cameras, times, truth)."""
    for folder in sequence.walk_arrays():
        name = folder.relative_to(sequence.root).as_posix()
        try:
            metadata = read_metadata(folder)
            count.unsealed += not is_sealed(folder)
            digest = None if is_sharded(metadata) else values_digest(sequence.open_array(name))
            if digest is not None and metadata["attributes"].get("digest", digest) != digest:
                yield Fault(f"{ARRAY_BROKEN} (its values are not those that were written)", f"{name}/{FILE}")
        except FileNotFoundError:
            continue  # a run that began meanwhile replaces it
        except (ArchiveError, ValueError, RuntimeError) as e:
            yield Fault(f"{ARRAY_BROKEN} ({e})", f"{name}/{FILE}")


def _sources(sequence: SequenceGroup, count: Count) -> Iterator[Fault]:
    """Source files with another content than at the import: every one is read, because size and time can stay as they
    were. Those that are gone are counted: what was made of them is whole, and who needs them says so."""
    for file in sequence.capture.files:
        if not os.path.exists(file.path):
            count.gone.append(file.path)
            continue
        count.sources += 1
        count.source_bytes += file.size
        try:
            how = file.damage()
        except SourceError as e:
            how = str(e)
        if how is not None:
            yield Fault(f"{SOURCE_CHANGED} ({how})", file.path)


def seal_all(sequence: SequenceGroup) -> int:
    """Add the checksums that the record and the descriptions of arrays lack, as they are now;
    returns how many were added."""
    added = 0
    if checksums.KEY not in sequence.record:
        write_record(sequence.root, sequence.record)
        added += 1
    for folder in sequence.walk_arrays():
        try:
            if not is_sealed(folder):
                whole = not is_sharded(read_metadata(folder))
                seal(
                    folder,
                    values_digest(sequence.open_array(folder.relative_to(sequence.root).as_posix())) if whole else None,
                )
                added += 1
        except (ForeignArray, ValueError, RuntimeError):
            continue  # it is a fault, and told as one
    return added


def key_of(receipt: Receipt) -> ReceiptKey:
    """Which task a receipt is about."""
    return ReceiptKey(receipt.stage, receipt.partition, receipt.view, receipt.path)


def _of_output(sequence: SequenceGroup, receipt: Receipt, output: Output, count: Count) -> list[Fault]:
    """Faults of the files of one output; of its content only where every file is as promised."""
    causes = [(f, _of_file(sequence, f)) for f in output.files]
    count.files += len(output.files)
    count.bytes += sum(f.size for f in output.files)
    found = [Fault(cause, f.key, output, receipt) for f, cause in causes if cause is not None]
    if not found and (cause := _of_content(sequence, receipt, output)) is not None:
        found.append(Fault(cause, output.array, output, receipt))
    return found


def _of_file(sequence: SequenceGroup, promised: ShardFile) -> str | None:
    try:
        data = read_shard(sequence, promised.key)
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


def _of_content(sequence: SequenceGroup, receipt: Receipt, output: Output) -> str | None:
    """Decode and compare with the content digest."""
    files = [sequence.place(f.key) for f in output.files]
    try:
        if all(f.suffix == ".parquet" for f in files):
            found = table_digest(pq.read_table(files[0]).to_pydict())
        else:
            block = _block(sequence, receipt, output)
            if block is None:
                return None
            found = content_digest(*block)
    except ShardMissing as e:
        return str(e)
    except (
        Exception
    ) as e:  # a broken array record or codec may raise anything; whatever it is, this output cannot be read
        return f"does not decode ({type(e).__name__}: {e})"
    return None if found == output.digest else "its content is not the promised one"


def _block(
    sequence: SequenceGroup, receipt: Receipt, output: Output
) -> tuple[np.ndarray, tuple[str | None, ...]] | None:
    """The block as it was written, and its dimensions; None where the array was cut or grown since, so that it cannot
    be read back whole.

    Raises ShardMissing where the array is read from other files than the output's.
    """
    array = sequence.open_array(output.array)
    dims: tuple[str | None, ...] = getattr(array.metadata, "dimension_names", None) or ()
    index: list[slice | int] = []
    whole = True
    for dim, length, shard in zip(dims, array.shape, array.shards or array.chunks, strict=True):
        if dim == "frame":
            assert receipt.partition is not None, f"{output.array} has frames, its receipt no partition"
            start = receipt.partition * shard
            frames = len(receipt.parts["bounds"][0])
            whole = frames == min(shard, length - start)
            index.append(slice(start, start + frames))
        else:
            index.append(output.view if dim == "view" and output.view is not None else slice(None))
    if (other := unpromised(output.array, array, tuple(index), output.files)) is not None:
        raise ShardMissing(f"its array is described so that {other} is read instead")
    if not whole:
        return None
    refuse_huge(
        output.array,
        [len(range(*i.indices(n))) for i, n in zip(index, array.shape, strict=True) if isinstance(i, slice)],
        array.dtype,
    )
    own = tuple(d for d, i in zip(dims, index, strict=True) if isinstance(i, slice))
    return np.asarray(array[tuple(index)]), own


def repair(sequence: SequenceGroup, fault: Fault) -> None:
    """Have the next run make anew what is broken. Raises LeaseHeld when a run works on it."""
    if fault.receipt is None:
        if not fault.foreign:
            _remove(sequence, fault.file)
        return
    key = key_of(fault.receipt)
    with Lease.take(lease_file(sequence, key), own_name("verify")):
        if read_receipt(sequence, key) == fault.receipt:
            remove_receipt(sequence, *key)


def _remove(sequence: SequenceGroup, key: str) -> None:
    """Remove one file; the calibrated cameras, which no run makes, are written again from the record."""
    sequence.place(key).unlink(missing_ok=True)
    if key.startswith("source/") and key.endswith(FILE):
        sequence.put_cameras()
