"""Whole shards, one writer each; reading with a halo, against what the receipts promise."""

from __future__ import annotations

import os
import re
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product, takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posegaussian.storage.archive.array_metadata import refuse_huge
from posegaussian.storage.archive.chunk_keys import shard_key, unpromised
from posegaussian.storage.archive.receipts import Output, ShardFile
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import FileSizes
from posegaussian.storage.files.write import refusals, sync_folder, write_atomically
from posegaussian.storage.model.errors import ArchiveError, ShardCorrupt, ShardMissing
from posegaussian.storage.model.spec import LISTED, ArraySpec, Shape, TableSpec, content_digest, digest
from posegaussian.storage.model.timegrid import TimeGrid

COMPILED = {"codec_pipeline.path": "zarrs.ZarrsCodecPipeline", "threading.max_workers": 1}
"""All chunks of a shard are encoded or decoded in one call of a compiled library, on one thread, as tasks run beside
each other: several times faster than zarr's own way, which starts a thread for every chunk."""
OF_ZEROS = {"codec_pipeline.path": "zarr.core.codec_pipeline.BatchedCodecPipeline", "array.write_empty_chunks": True}
"""zarr's own way, for shards of zeros: the compiled library writes none, and an absent shard must never mean zeros."""
_CONFIGURING = threading.Lock()
"""Held while zarr's configuration, which is one for all threads, is another one: what threads put back in turns would
stay."""
_SYSTEM_ERROR = re.compile(r"\(os error (\d+)\)")
"""How the compiled library ends a sentence about what the system told it."""
WHOLE = ("frame", "view", LISTED)
"""Dimensions of which a block has no more than one shard's part: of a list all."""
Guard = Callable[[], object]
"""Called before every file that is written; raises where the writer has lost its right to write."""


def free() -> None:
    """The guard of a writer nobody else can disturb."""


@contextmanager
def _system_errors(path: Path) -> Iterator[None]:
    """Within, what the system told the compiled library about a file or folder is an OSError, as everywhere else: it
    comes as a RuntimeError, the same as damage does, and only the system's errors may pass by waiting."""
    try:
        yield
    except RuntimeError as e:
        told = _SYSTEM_ERROR.search(str(e))
        if told is None:
            raise
        raise OSError(int(told[1]), os.strerror(int(told[1])), str(path)) from e


def _record(sequence: SequenceGroup, key: str, made: Iterable[Path]) -> ShardFile:
    """Sync a shard, its folder, and where folders were made for it; and describe it."""
    path = sequence.place(key)
    with refusals(path), open(path, "rb") as f:
        data = f.read()
        os.fsync(f.fileno())
        for folder in (path.parent, *(m.parent for m in made)):
            sync_folder(folder)
    return ShardFile(key, len(data), zlib.crc32(data))


def _missing_folders(path: Path) -> list[Path]:
    """Folders that must be made for a file, deepest first."""
    return list(takewhile(lambda folder: not folder.is_dir(), path.parents))


def _open(sequence: SequenceGroup, name: str, mode: Literal["r", "r+"], codecs: Mapping[str, Any] = COMPILED) -> Any:
    import zarr  # not above: see storage/archive/store.py

    try:
        with _CONFIGURING, zarr.config.set(codecs):
            return sequence.open_array(name, mode)
    except FileNotFoundError:
        raise ShardMissing(
            f"array {name} of sequence {sequence.name} has no zarr.json; `posegaussian verify --sequence"
            f" {sequence.name} --repair` has it made anew"
        ) from None


def require_array(sequence: SequenceGroup, spec: ArraySpec, path: str, shape: Shape) -> None:
    """Raise ArchiveError where an array is not the declared one for lengths of dimensions {name: length}, but for its
    frames, which runs of more of them add; and ShardMissing where there is none."""
    name, declared = spec.name.format(path=path), spec.lengths(shape)
    array = _open(sequence, name, "r")
    differ = array.dtype != np.dtype(spec.dtype) or len(array.shape) != len(declared)
    if differ or any(a != b and d != "frame" for d, a, b in zip(spec.dims, array.shape, declared, strict=True)):
        raise ArchiveError(
            f"{name} of sequence {sequence.name} is {array.dtype} {array.shape}, and {spec.dtype} {declared} is to be"
            " written: another run with other settings replaced it; two such runs cannot share an archive: let one end,"
            " then run again"
        )


def write_array(
    sequence: SequenceGroup,
    spec: ArraySpec,
    path: str,
    frames: range,
    partition: int | None,
    view: int | None,
    data: np.ndarray,
    guard: Guard = free,
) -> Output:
    """Write the shards of one (array, partition, view) whole, one after the other.

    Args:
        sequence: where to.
        spec: the declaration; `path` fills the `{path}` in its name.
        path: camera path, or "".
        frames: frame indices of the partition (ignored for arrays without a frame axis).
        partition: number of the partition.
        view: index of the view, for arrays with a view axis.
        data: the block, without the view axis; of a list with as many entries as are used, or more.
        guard: called before every shard.

    Raises:
        ValueError: when shape or dtype are not the declared ones, or the view is not one of the array's.
    """
    name = spec.name.format(path=path)
    array = _open(sequence, name, "r+")
    views = dict(zip(spec.dims, array.shape, strict=True)).get("view")
    fits = views is view if views is None or view is None else 0 <= view < views
    if not fits:
        raise ValueError(
            f"{name}: got a block of view {view}; "
            + ("the array has no views" if views is None else f"its views are 0..{views - 1}")
        )
    own = [d for d in spec.dims if d != "view"]
    data = _whole_pieces(data, own, dict(zip(spec.dims, zip(array.shape, array.chunks, strict=True), strict=True)))
    first = data.shape[own.index(LISTED)] if LISTED in own and data.ndim == len(own) else None
    index = _index(spec.dims, frames, view, first)
    expected = tuple(len(range(*i.indices(n))) for i, n in zip(index, array.shape, strict=True) if isinstance(i, slice))
    if data.shape != expected or data.dtype != array.dtype:
        raise ValueError(f"{name}: got {data.dtype} {data.shape}, declared {array.dtype} {expected} over {spec.dims}")
    axes: list[list[int]] = []
    for d, n, s in zip(spec.dims, array.shape, array.shards, strict=True):
        axes.append([partition or 0] if d == "frame" else [view or 0] if d == "view" else list(range(-(-n // s))))
    files = []
    for where in product(*axes):
        into, of = _region(spec.dims, array.shards, where, index)
        guard()
        key = shard_key(name, array, where)
        file = sequence.place(key)
        made = _missing_folders(file)
        with refusals(file, data[of].nbytes), _system_errors(file):
            file.unlink(missing_ok=True)
            (array if data[of].any() else _open(sequence, name, "r+", OF_ZEROS))[into] = data[of]
        files.append(_record(sequence, key, made))
    return Output(name, view, content_digest(data, own), tuple(files))


def _whole_pieces(data: np.ndarray, dims: Sequence[str], lengths: Mapping[str, tuple[int, int]]) -> np.ndarray:
    """A block whose list, if it has one, ends with a chunk, the first at least; {dimension: (length, chunk)}."""
    if LISTED not in dims or data.ndim != len(dims):
        return data
    axis, (length, piece) = dims.index(LISTED), lengths[LISTED]
    whole = min(length, -(-max(1, data.shape[axis]) // piece) * piece)
    return np.pad(data, [(0, max(0, whole - n) if i == axis else 0) for i, n in enumerate(data.shape)])


def _index(
    dims: Iterable[str], span: range, view: int | None, first: int | None, cameras: range | None = None
) -> tuple[slice | int, ...]:
    """Of the frames of a span and one view, if there are views, in an array; of a list the first so many, or all; of a
    path's cameras those of a range, or all."""
    own: dict[str, slice | int] = {"frame": slice(span.start, span.stop), LISTED: slice(first)}
    if view is not None:
        own["view"] = view
    if cameras is not None:
        own["camera"] = slice(cameras.start, cameras.stop)
    return tuple(own.get(d, slice(None)) for d in dims)


def _region(
    dims: tuple[str, ...], shards: tuple[int, ...], where: tuple[int, ...], index: tuple[Any, ...]
) -> tuple[tuple[Any, ...], tuple[slice, ...]]:
    """(index into the array, index into the block) of one shard:
    the block has one partition's frames and no view axis."""
    into, of = [], []
    for d, length, number, whole in zip(dims, shards, where, index, strict=True):
        part = whole if d in WHOLE else slice(number * length, (number + 1) * length)
        into.append(part)
        if d != "view":
            of.append(slice(None) if d in WHOLE else part)
    return tuple(into), tuple(of)


def write_table(
    sequence: SequenceGroup,
    spec: TableSpec,
    path: str,
    partition: int | None,
    columns: Mapping[str, list[Any]],
    guard: Guard = free,
) -> Output:
    """Write one partition's rows as a Parquet file. Raises ValueError when the columns are not the declared ones."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if list(columns) != [c for c, _ in spec.columns]:
        raise ValueError(f"{spec.name}: got columns {list(columns)}, declared {[c for c, _ in spec.columns]}")
    table = pa.table(dict(columns), schema=pa.schema([(c, pa.type_for_alias(t)) for c, t in spec.columns]))
    name = spec.name.format(path=path)
    key = f"{name}/{'all' if partition is None else f'p{partition:06d}'}.parquet"
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    guard()
    write_atomically(sequence.place(key), sink.getvalue().to_pybytes())
    return Output(name, None, table_digest(columns), (_record(sequence, key, ()),))


def table_digest(columns: Mapping[str, list[Any]]) -> str:
    """Content digest of a table: its columns in order."""
    return digest([[str(v) if isinstance(v, float) else v for v in column] for column in columns.values()])


def verify_files(sequence: SequenceGroup, files: Iterable[ShardFile]) -> None:
    """Raise ShardMissing or ShardCorrupt when a file is not there or not of the promised size."""
    look = FileSizes(sequence.root)
    for f in files:
        size = look.size(f.key)
        if size < 0:
            raise ShardMissing(f"shard {f.key} of sequence {sequence.name} is missing; run again to make it anew")
        if size != f.size:
            raise ShardCorrupt(
                f"shard {f.key} of sequence {sequence.name} has {size} bytes, its receipt says {f.size};"
                " run again to make it anew"
            )


def read_array(
    sequence: SequenceGroup,
    name: str,
    dims: tuple[str, ...],
    span: range,
    view: int | None,
    files: Iterable[ShardFile],
    first: int | None = None,
    cameras: range | None = None,
) -> np.ndarray:
    """Read the frames of `span` of one view, after checking the shards that hold them.

    Returns [len(span), ...] without the view axis (without the frame axis for arrays that have none); of a list the
    `first` so many entries, or all; of the cameras of a path some that follow each other, or all.

    Raises:
        ShardMissing, ShardCorrupt: also when a checksum inside a shard does not match, the array ends before the span
            does, or it would be read from other files than `files`: one that is not there would be read as zeros.
        OSError: where the disk cannot be read.
    """
    files = tuple(files)
    verify_files(sequence, files)
    array = _open(sequence, name, "r")
    index = _index(dims, span, view, first, cameras)
    refuse_huge(
        name,
        [len(range(*i.indices(n))) for i, n in zip(index, array.shape, strict=True) if isinstance(i, slice)],
        array.dtype,
    )
    held = dict(zip(dims, array.shape, strict=True)).get("frame", span.stop)
    if span.stop > held:
        raise ShardMissing(
            f"array {name} of sequence {sequence.name} has {held} frames, and {span.start}..{span.stop - 1} (counted"
            " from 0) are asked for; run again to make them"
        )
    if (other := unpromised(name, array, index, files)) is not None:
        raise ShardMissing(
            f"array {name} of sequence {sequence.name} is described so that {other} is read, which no receipt promises;"
            f" `posegaussian verify --sequence {sequence.name} --repair` has the next run make it anew"
        )
    try:
        with _system_errors(sequence.place(name)):
            return np.asarray(array[index])
    except (ValueError, RuntimeError) as e:
        raise ShardCorrupt(
            f"array {name} of sequence {sequence.name}, frames {span.start}..{span.stop - 1} (counted from 0), view"
            f" {view}: {e}; `posegaussian verify --sequence {sequence.name} --repair` finds all such shards and has the"
            " next run make them anew"
        ) from e


def read_frames(
    sequence: SequenceGroup,
    name: str,
    outputs: Mapping[tuple[int, int | None], Output],
    grid: TimeGrid,
    frames: range,
    view: int | None = None,
    first: int | None = None,
    cameras: range | None = None,
) -> np.ndarray:
    """Read frames of an array that a run wrote, for export and inspection: [len(frames), ...], of a list the `first` so
    many entries, or all, of a path's cameras those of a range, or all.

    `outputs` maps (partition, view) to what the receipts promise. Raises ShardMissing where a partition has none, and
    ShardMissing and ShardCorrupt as `read_array` does.
    """
    files: list[ShardFile] = []
    for partition in grid.touched(frames):
        output = outputs.get((partition, view))
        if output is None:
            raise ShardMissing(
                f"array {name} of sequence {sequence.name} has no finished partition {partition}; run again to make it"
            )
        files += output.files
    dims = tuple(_open(sequence, name, "r").metadata.dimension_names or ())
    return read_array(sequence, name, dims, frames, view, files, first, cameras)
