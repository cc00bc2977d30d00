"""An archive is one folder (or file:// URL): a catalogue, and one Zarr v3 group for every sequence.

This module creates and opens groups and arrays; it writes no data (`shards.py`) and knows no stage. zarr is imported
where an array is touched: a plan and a status read records and receipts only, and start a third sooner without it.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np

from posegaussian.storage.archive.array_metadata import (
    SHARD_NAMES,
    ForeignArray,
    is_group,
    is_sealed,
    read_metadata,
    refuse_huge,
    seal,
    unseal,
)
from posegaussian.storage.archive.records import (
    FILE,
    FORMAT,
    as_recorded,
    cameras,
    check_capture,
    read_capture,
    read_record,
    write_record,
)
from posegaussian.storage.files.names import Unsafe, below, files_below, folders_in, name_fault
from posegaussian.storage.files.write import make_folder, refusals, sync_folder, write_atomically
from posegaussian.storage.model.cameras import INTRINSICS_AXES, POSE_AXES, Rig
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import ArchiveError, NotWritten
from posegaussian.storage.model.home import at_home
from posegaussian.storage.model.spec import BATCH_DIMS, LISTED, ArraySpec, Shape, array_digest

RESHARD = "_reshard"
"""Folder below the archive's where a sequence is cut anew: `new/<name>` until it is whole, `old/<name>` from the
first rename on."""

SOURCES = "_sources"
"""Folder of the source files that were copied into a sequence."""

MAX_CHUNK_BYTES = 16 * 2**20
"""Pictures larger than this are tiled into several chunks of one shard."""


LIST_PIECES = 64
"""Of a list, each a chunk: of 512 x 512 px 4096 entries."""


def _pipeline() -> tuple[Any, ...]:
    """What of zarr's configuration an array keeps from when it was opened."""
    import zarr

    return zarr.config.get("codec_pipeline.path"), zarr.config.get("array.write_empty_chunks")


@lru_cache(maxsize=256)
def _opened(folder: Path, mode: Literal["r", "r+"], description: tuple[int, ...], pipeline: tuple[Any, ...]) -> Any:
    """An array of a folder. A task opens the same ones for every view, at some milliseconds each: an array is opened
    again when its `description` has another inode, size or time."""
    import zarr

    read_metadata(folder)
    return zarr.open_array(folder, mode=mode, zarr_format=3)


def codecs(dtype: np.dtype) -> list[Any]:
    """Compressors by element type; Blosc alone does not notice a flipped bit, the checksum does.

    Fields of a person are zero outside the mask: with bytes shuffled those zeros cost little, with bits shuffled every
    one of 16 or 32 planes pays for every row. Measured on depth and its slopes of a capsule person (192 and 384 px, a
    box of 0.3 of the picture): bits shuffled take 43 and 33 % more bytes. The zeros outside the mask's box are 2 to 3 %
    of the bytes (tests/storage/archive/test_codecs.py), so fields are stored whole, as any Zarr reader expects them,
    and not cut to a box. Level 5 takes 7 % fewer bytes and twice as long to write (docs/measurements/bytes.md).
    """
    from zarr.codecs import BloscCodec, Crc32cCodec

    return [
        BloscCodec(cname="zstd", clevel=3, shuffle="shuffle", typesize=dtype.itemsize),
        Crc32cCodec(),
    ]


def layout(
    spec: ArraySpec, shape: Shape, partition_frames: int
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """(lengths, chunk, shard) of an array: a chunk is one frame of one view, a shard one partition of one view or
    camera.

    Larger pictures are cut into tiles of equal height; the shard then spans whole tiles, a few rows beyond the picture.
    Lists are cut into pieces, so that those of zeros alone need not be kept.
    """
    lengths = spec.lengths(shape)
    chunk = [1 if d in BATCH_DIMS else n for d, n in zip(spec.dims, lengths, strict=True)]
    shard = [
        {"frame": partition_frames, "view": 1, "camera": 1}.get(d, n) for d, n in zip(spec.dims, lengths, strict=True)
    ]
    for axis, dim in enumerate(spec.dims):
        if dim == LISTED:
            chunk[axis] = -(-lengths[axis] // LIST_PIECES)
            shard[axis] = chunk[axis] * LIST_PIECES
        if dim.split("/")[0] not in ("y", "camera_y", "source_y"):
            continue
        row_bytes = math.prod(chunk[:axis] + chunk[axis + 1 :]) * np.dtype(spec.dtype).itemsize
        tiles = -(-lengths[axis] // max(1, MAX_CHUNK_BYTES // max(1, row_bytes)))
        if tiles > 1:
            chunk[axis] = -(-lengths[axis] // tiles)
            shard[axis] = chunk[axis] * tiles
    return tuple(max(1, n) for n in lengths), tuple(max(1, n) for n in chunk), tuple(max(1, n) for n in shard)


def local_path(url: str) -> Path:
    """The folder behind an archive's URL. Raises ArchiveError for object stores, which format 1 cannot write safely."""
    scheme, separator, rest = url.partition("://")
    if not separator:
        return Path(at_home(url)).resolve()
    if scheme == "file":
        return Path(unquote(rest)).resolve()
    raise ArchiveError(
        f"archive {url}: format {FORMAT} runs on a local or POSIX folder only; {scheme} stores lack the conditional"
        " writes a run needs"
    )


def _finish_reshards(root: Path) -> None:
    """Put a new sequence in its place where a reshard died between its two renames:
    the old one is away, the new one is whole."""
    for new in folders_in(below(root, f"{RESHARD}/new")):
        old, place = below(root, f"{RESHARD}/old/{new.name}"), below(root, new.name)
        if (new / FILE).is_file() and old.is_dir() and not place.exists() and sequence_name_fault(new.name) is None:
            with contextlib.suppress(OSError):  # another process may be quicker
                os.rename(new, place)
                sync_folder(root)


def sequence_name_fault(name: str) -> str | None:
    """Why a name cannot be a sequence's; None where it can. Folders of the archive's own start with an underscore."""
    return "it starts with an underscore" if name.startswith("_") else name_fault(name)


@dataclass(frozen=True)
class Archive:
    """A folder of sequences."""

    root: Path
    """The archive's folder."""

    @classmethod
    def open(cls, url: str, *, create: bool = False) -> Archive:
        """Open an archive; ArchiveError says what to do when there is none there."""
        root = local_path(url)
        if create:
            make_folder(root)
        if not root.is_dir():
            raise ArchiveError(
                f"there is no archive at {root}; `posegaussian import auto FOLDER` makes one of a capture,"
                " `posegaussian simulate plain` of a simulated person; `--archive URL` names another"
            )
        _finish_reshards(root)
        return cls(root)

    def names(self) -> list[str]:
        """Names of the sequences, sorted."""
        return sorted(p.parent.name for p in self.root.glob(f"*/{FILE}") if not p.parent.name.startswith(("_", ".")))

    def place(self, key: str) -> Path:
        """Where something of the archive lies or will lie.
        Raises Unsafe where the key or a symbolic link leads out of it."""
        return below(self.root, key)

    def sequence(self, name: str) -> SequenceGroup:
        """One sequence. Raises ArchiveError with the known names, or for a newer format;
        Unsafe for a link in its place."""
        if (why := sequence_name_fault(name)) is not None:
            raise Unsafe(
                f"archive {self.root} has a folder {name!r} that cannot be a sequence: {why}; take it away or rename it"
            )
        sequence = SequenceGroup(self.place(name))
        if not sequence.place(FILE).is_file():
            known = ", ".join(self.names()) or "none yet"
            raise ArchiveError(f"archive {self.root} has no sequence {name!r}; it has: {known}")
        _ = sequence.record  # refuses a newer format
        return sequence

    def create_sequence(self, name: str, capture: Capture, partition_frames: int) -> SequenceGroup:
        """Register a capture under a name, replacing an earlier registration but not its results.

        Raises ArchiveError for a name that cannot be a folder, SourceError for a capture that could not be read again,
        and NotWritten where the disk does not take it; a sequence that was not there before is then not there either.
        """
        self.check_sequence_name(name)
        check_capture(capture)
        root = self.place(name)
        new = not root.exists() or {p.name for p in root.iterdir()} <= {SOURCES}
        try:
            with refusals(root):
                return self._registered(root, capture, partition_frames)
        except NotWritten:
            if new:
                shutil.rmtree(root, ignore_errors=True)
            raise

    def _registered(self, root: Path, capture: Capture, partition_frames: int) -> SequenceGroup:
        # The record is there from the first moment:
        # a kill in between must not leave a folder that looks like a broken sequence.
        write_record(
            root, {"format": FORMAT, "partition_frames": partition_frames, "capture": as_recorded(capture, root)}
        )
        sequence = SequenceGroup(root)
        sequence.put_cameras()
        sync_folder(root)
        self.write_catalog()
        return sequence

    def check_sequence_name(self, name: str) -> None:
        """Raise ArchiveError for a name that cannot be a folder, Unsafe where a link lies in its place."""
        why = "it starts with a dash, as options do" if name.startswith("-") else sequence_name_fault(name)
        if why is not None:
            raise ArchiveError(f"sequence name {name!r} cannot be a folder's name: {why}; use letters, digits, - and _")
        self.place(name)

    def write_catalog(self) -> None:
        """Write `catalog.parquet`, one row a sequence, from the sequences' own records;
        one that cannot be read has no row."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        rows = []
        for name in self.names():
            try:
                s = self.sequence(name)
            except ArchiveError:
                continue  # every command that touches the sequence says what is wrong with it
            c = s.capture
            rows.append(
                {
                    "sequence": name,
                    "layout": c.layout,
                    "views": len(c.rig),
                    "frames": len(c.numbers),
                    "frame_rate": c.frame_rate,
                    "partition_frames": s.partition_frames,
                }
            )
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(rows), sink)
        write_atomically(self.place("catalog.parquet"), sink.getvalue().to_pybytes())


@dataclass(frozen=True)
class SequenceGroup:
    """One sequence's group and the folders of its receipts."""

    root: Path
    """The group's folder."""

    @property
    def name(self) -> str:
        """The sequence's name."""
        return self.root.name

    @cached_property
    def record(self) -> dict[str, Any]:
        """The project's record. Raises BrokenRecord when it is missing, broken or changed,
        ArchiveError for a newer format."""
        return read_record(self.root)

    @cached_property
    def capture(self) -> Capture:
        """The registered capture. Raises BrokenRecord where the record does not describe one."""
        return read_capture(self.record, self.root / FILE)

    @property
    def partition_frames(self) -> int:
        """Frames of a partition, fixed at import."""
        return int(self.record["partition_frames"])

    @property
    def receipts(self) -> Path:
        """Folder of the receipts. Raises Unsafe for a link in its place."""
        return self.place("_receipts")

    def place(self, key: str) -> Path:
        """Where something of the sequence lies or will lie.
        Raises Unsafe where the key or a symbolic link leads out of it."""
        return below(self.root, key)

    def open_array(self, name: str, mode: Literal["r", "r+"] = "r") -> Any:
        """An array as zarr opens it, after its description was looked through.

        Raises Unsafe for its place, ForeignArray for its description, FileNotFoundError where there is none.
        """
        folder = self.place(name)
        stat = (folder / FILE).lstat()
        return _opened(folder, mode, (stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns), _pipeline())

    def put(
        self,
        name: str,
        data: np.ndarray,
        dims: tuple[str, ...],
        unit: str,
        meaning: str,
        chunk: tuple[int, ...] | None = None,
    ) -> None:
        """Write an array that is not partitioned, unless it already holds these values;
        in one chunk unless told otherwise."""
        import zarr

        folder, digest = self.place(name), array_digest(data)
        if self._holds(name, data, dims):
            if not is_sealed(folder):
                seal(folder, digest)
            return
        attributes: Any = {"unit": unit, "meaning": meaning, "digest": digest}
        with refusals(folder, data.nbytes):
            array = zarr.create_array(
                self.root,
                name=name,
                data=np.ascontiguousarray(data),
                chunks=tuple(max(1, n) for n in chunk or data.shape),
                compressors=codecs(data.dtype),
                chunk_key_encoding=SHARD_NAMES,
                overwrite=True,
                dimension_names=dims,
                attributes=attributes,
                config={"write_empty_chunks": True},
            )
        assert array.shape == data.shape
        seal(folder)

    def _holds(self, name: str, data: np.ndarray, dims: tuple[str, ...]) -> bool:
        """Whether an array is there, whole, and holds these values along these dimensions."""
        try:
            old = self.open_array(name)
            same = (old.shape, old.dtype, old.metadata.dimension_names) == (data.shape, data.dtype, dims)
            return same and np.array_equal(old[...], data)
        except (FileNotFoundError, ForeignArray, ValueError, RuntimeError):
            return False  # it is written anew

    def get(self, name: str) -> np.ndarray:
        """A small array, whole. Raises ArchiveError when it is not there,
        or its values are not those that were written."""
        try:
            array = self.open_array(name)
        except FileNotFoundError as e:
            raise ArchiveError(f"sequence {self.name} has no array {name}") from e
        refuse_huge(name, array.shape, array.dtype)
        try:
            values = np.asarray(array[...])
        except (ValueError, RuntimeError) as e:
            raise ArchiveError(
                f"array {name} of sequence {self.name} is damaged: {e}; `posegaussian verify --sequence {self.name}"
                " --repair` has it made anew"
            ) from e
        if array.attrs.get("digest", digest := array_digest(values)) != digest:
            raise ArchiveError(
                f"array {name} of sequence {self.name} does not hold what was written; `posegaussian verify --sequence"
                f" {self.name} --repair` has it made anew"
            )
        return values

    def ensure_array(self, spec: ArraySpec, shape: Shape, path: str = "") -> None:
        """Create the array of a spec, grow or shrink it along time, or replace it when any other length changed.

        `{path}` in the name is replaced. Existing shards, and how they are named, are kept when only the number of
        frames changed.
        """
        import zarr

        name = spec.name.format(path=path)
        lengths, chunk, shard = layout(spec, shape, self.partition_frames)
        attributes: Any = {"unit": spec.unit, "meaning": spec.meaning, "keep": spec.keep}
        change, folder = self._change(spec, shape, path), self.place(name)
        if change is None:
            if not is_sealed(folder):
                seal(folder)
            return
        with refusals(folder):
            if change in ("grow", "shrink"):
                unseal(folder)
                self.open_array(name, "r+").resize(lengths)
                seal(folder)
                return
            zarr.create_array(
                self.root,
                name=name,
                shape=lengths,
                chunks=chunk,
                shards=shard,
                dtype=spec.dtype,
                compressors=codecs(np.dtype(spec.dtype)),
                chunk_key_encoding=SHARD_NAMES,
                fill_value=0,
                overwrite=True,
                dimension_names=spec.dims,
                attributes=attributes,
                config={"write_empty_chunks": True},
            )
            seal(folder)

    def _change(
        self, spec: ArraySpec, shape: Shape, path: str
    ) -> Literal["create", "grow", "shrink", "replace"] | None:
        """What `ensure_array` has to do."""
        lengths, chunk, shard = layout(spec, shape, self.partition_frames)
        try:
            old = self.open_array(spec.name.format(path=path))
        except FileNotFoundError:
            return "create"
        differ = (
            [d for d, a, b in zip(spec.dims, old.shape, lengths, strict=True) if a != b]
            if old.ndim == len(lengths)
            else ["rank"]
        )
        if old.dtype != np.dtype(spec.dtype) or old.chunks != chunk or old.shards != shard or set(differ) - {"frame"}:
            return "replace"
        return (
            ("grow" if lengths[spec.dims.index("frame")] > old.shape[spec.dims.index("frame")] else "shrink")
            if differ
            else None
        )

    def destroys(self, spec: ArraySpec, shape: Shape, path: str = "") -> bool:
        """Whether `ensure_array` would delete shards that are there."""
        return self._change(spec, shape, path) in ("shrink", "replace")

    def lacks_frames(self, spec: ArraySpec, shape: Shape, path: str = "") -> bool:
        """Whether the array is there, can be read, and has fewer frames than the shape; all else is alike."""
        try:
            return self._change(spec, shape, path) == "grow"
        except ForeignArray:  # who reads it says so
            return False

    def put_cameras(self) -> None:
        """Write the calibrated cameras of the record as `source/*`."""
        for name, values in cameras(self.capture.rig).items():
            self.put(name, *values)

    def put_rig(self, prefix: str, rig: Rig) -> None:
        """Write the cameras a reader of `<prefix>/*` needs: intrinsics, world_to_camera, size."""
        self.put(f"{prefix}/intrinsics", rig.intrinsics, ("view", *INTRINSICS_AXES), "px", "Our pixel centres.")
        self.put(
            f"{prefix}/world_to_camera",
            rig.world_to_camera,
            ("view", *POSE_AXES),
            "m",
            "Rigid motion, OpenCV axes.",
        )
        self.put(
            f"{prefix}/size",
            rig.size.astype(np.int32),
            ("view", "wh"),
            "px",
            "Size of each view's picture; arrays are padded to the largest.",
        )

    def walk_arrays(self) -> Iterator[Path]:
        """Folders of all arrays of the sequence, by their descriptions; one that cannot be read counts as an
        array's. Raises Unsafe."""
        for file in files_below(self.root):
            folder, _, name = file.rpartition("/")
            if name == FILE and folder != str(self.root) and not is_group(Path(folder)):
                yield Path(folder)
