"""The description of an array, its `zarr.json`: looked through before zarr makes codecs and memory of it.

An array is of Zarr version 3 and written as `archive.py` writes it: numbers, on a regular grid, shards of chunks,
chunks of bytes packed by Blosc (zstd) with a checksum; nothing else is opened. Descriptions carry a checksum of their
own.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from posegaussian.storage.archive import checksums
from posegaussian.storage.archive.records import FILE
from posegaussian.storage.files.names import parse_json, read_file
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ArchiveError
from posegaussian.storage.model.spec import array_digest

MOST_BYTES = 2**20
"""Bytes of a description."""

MOST_LENGTH = 2**31
"""Length of a dimension."""

MOST_CHUNK_BYTES = 2**30
"""Bytes of a chunk before compression."""

MOST_CHUNKS = 2**20
"""Chunks of a shard, each with an entry in its index."""

MOST_SHARDS = 2**22
"""Shards of an array: making it shorter looks at every one."""

TYPES = (
    "bool",
    "int8",
    "int16",
    "int32",
    "int64",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "float16",
    "float32",
    "float64",
)
"""Types of elements."""

SHARD_NAMES: dict[str, Any] = {"name": "default", "configuration": {"separator": "."}}
"""How new arrays name their shards: one file each in the array's folder.
Every folder takes an inode, as a file does."""

NESTED_NAMES: dict[str, Any] = {"name": "default", "configuration": {"separator": "/"}}
"""How arrays of earlier versions do: a folder for every number."""

PART_BYTES = 2**26
"""Bytes of an array that are read at a time for its digest."""

KEYS = {
    "shape",
    "data_type",
    "chunk_grid",
    "chunk_key_encoding",
    "fill_value",
    "codecs",
    "attributes",
    "dimension_names",
    "zarr_format",
    "node_type",
    "storage_transformers",
}


class ForeignArray(ArchiveError):
    """An array whose description is missing, is not one that this program writes, or changed since it was written."""


def read_metadata(folder: Path) -> dict[str, Any]:
    """The description of the array in a folder. Raises ForeignArray, FileNotFoundError where there is none."""
    file = folder / FILE
    try:
        found = parse_json(read_file(file, MOST_BYTES))
        why = _fault(found)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as e:
        why = f"{type(e).__name__}: {e}"
    if why is None and _is_sealed(found) and found["attributes"][checksums.KEY] != _checksum(found):
        why = "it changed since it was written: it is not what its checksum was taken of"
    if why is not None:
        raise ForeignArray(
            f"{file} does not describe an array as this program writes it ({why}); put the file back as it was, or"
            " `posegaussian verify --repair` removes it and the next run makes the array anew"
        )
    return found


def seal(folder: Path, digest: str | None = None) -> None:
    """Add its checksum to the description of an array, and the digest of its values where they are known."""
    _write(folder, digest, True)


def unseal(folder: Path) -> None:
    """Take the checksum away before zarr changes the description: killed in between, it leaves one without."""
    _write(folder, None, False)


def is_sharded(metadata: dict[str, Any]) -> bool:
    """Whether an array is written shard by shard, each promised by a receipt; else it was written whole."""
    return metadata["codecs"][0]["name"] == "sharding_indexed"


def separator(metadata: dict[str, Any]) -> str:
    """What stands between the numbers in the name of a shard."""
    return str(metadata["chunk_key_encoding"]["configuration"]["separator"])


def copy_description(source: Path, folder: Path) -> None:
    """Describe an array as the one in another folder; one that is there keeps its names of shards, by which they lie
    there.

    Raises ForeignArray for either, FileNotFoundError where there is no source.
    """
    found = read_metadata(source)
    with contextlib.suppress(FileNotFoundError):
        found = {**found, "chunk_key_encoding": read_metadata(folder)["chunk_key_encoding"]}
    if _is_sealed(found):
        found["attributes"] = {**found["attributes"], checksums.KEY: _checksum(found)}
    write_atomically(folder / FILE, json.dumps(found, indent=2).encode())


def values_digest(array: Any) -> str:
    """`array_digest` of an array in the archive, a part of it in memory at a time. Raises ValueError and
    RuntimeError for damaged chunks."""
    h = hashlib.blake2b(f"{array.dtype.str}{array.shape}".encode(), digest_size=16)
    if not array.ndim:
        return array_digest(np.asarray(array[...]))
    step = max(1, PART_BYTES // max(1, array.dtype.itemsize * math.prod(array.shape[1:])))
    for start in range(0, array.shape[0], step):
        h.update(np.ascontiguousarray(array[start : start + step]).tobytes())
    return h.hexdigest()


def is_sealed(folder: Path) -> bool:
    """Whether the description of an array has a checksum. Raises like `read_metadata`."""
    return _is_sealed(read_metadata(folder))


def _is_sealed(metadata: dict[str, Any]) -> bool:
    return checksums.KEY in metadata["attributes"]


def is_group(folder: Path) -> bool:
    """Whether what lies in a folder is a group and no array; False for what cannot be read. Raises Unsafe."""
    try:
        return parse_json(read_file(folder / FILE, MOST_BYTES)).get("node_type") == "group"
    except (OSError, ValueError, AttributeError):
        return False


def _checksum(metadata: dict[str, Any]) -> str:
    return checksums.checksum({**metadata, "attributes": _attributes(metadata)})


def _attributes(metadata: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in metadata["attributes"].items() if k != checksums.KEY}


def _write(folder: Path, digest: str | None, with_checksum: bool) -> None:
    found = parse_json(read_file(folder / FILE, MOST_BYTES))
    own = _attributes(found) | ({} if digest is None else {"digest": digest})
    found["attributes"] = own
    if with_checksum:
        found["attributes"] = {**own, checksums.KEY: _checksum(found)}
    write_atomically(folder / FILE, json.dumps(found, indent=2).encode())


def refuse_huge(name: str, lengths: Sequence[int], dtype: np.dtype) -> None:
    """Raise ForeignArray for a block that no memory of this machine holds:
    a description promises any size in a few bytes."""
    need, there = math.prod(lengths) * dtype.itemsize, psutil.virtual_memory().total
    if need > there:
        raise ForeignArray(
            f"array {name}: a block of {'x'.join(map(str, lengths))} {dtype} is {need / 1e9:.0f} GB, this machine has"
            f" {there / 1e9:.0f} GB of memory; its description is damaged or a stranger's,"
            " `posegaussian verify` says which"
        )


def _fault(meta: dict[str, Any]) -> str | None:
    """Why a description is none of ours, or None; KeyError, TypeError and the like for what it lacks."""
    if meta.get("zarr_format") != 3 or meta.get("node_type") != "array":
        return (
            f"Zarr format {str(meta.get('zarr_format'))[:20]}, {str(meta.get('node_type'))[:20]};"
            " arrays of format 3 are read"
        )
    if unknown := sorted(meta.keys() - KEYS):
        return f"unknown entries {', '.join(unknown)[:80]}"
    if meta.get("storage_transformers", []):
        return f"storage transformers {json.dumps(meta['storage_transformers'])[:80]}, none are read"
    if meta["data_type"] not in TYPES:
        return f"data type {json.dumps(meta['data_type'])[:80]}, read are {', '.join(TYPES)}"
    if isinstance(meta["fill_value"], str) or meta["fill_value"] != 0:
        return f"fill value {json.dumps(meta['fill_value'])[:40]}, ours is 0"
    if meta["chunk_key_encoding"] not in (SHARD_NAMES, NESTED_NAMES) or meta["chunk_grid"]["name"] != "regular":
        return "another chunk grid or another naming of chunks"
    shape, names = meta["shape"], meta["dimension_names"]
    if (
        not isinstance(meta["attributes"], dict)
        or not isinstance(names, list)
        or len(names) != len(shape)
        or not all(isinstance(n, str) for n in names)
    ):
        return "attributes or names of dimensions that do not fit"
    return _grid_fault(
        shape, meta["chunk_grid"]["configuration"]["chunk_shape"], meta["codecs"], np.dtype(meta["data_type"]).itemsize
    )


def _grid_fault(shape: list[int], shard: list[int], codecs: list[Any], size: int) -> str | None:
    """What is wrong with lengths and codecs."""
    chunk = shard
    if len(codecs) == 1 and codecs[0]["name"] == "sharding_indexed":
        inner = codecs[0]["configuration"]
        chunk = inner["chunk_shape"]
        if (
            inner.keys() != {"chunk_shape", "codecs", "index_codecs", "index_location"}
            or inner["index_location"] != "end"
        ):
            return "another kind of shards"
        if (
            len(inner["index_codecs"]) != 2
            or not _is_bytes(inner["index_codecs"][0])
            or not _is_checksum(inner["index_codecs"][1])
        ):
            return f"codecs of the shards' index {json.dumps(inner['index_codecs'])[:120]}"
        codecs = inner["codecs"]
    if len(codecs) != 3 or not _is_bytes(codecs[0]) or not _is_blosc(codecs[1]) or not _is_checksum(codecs[2]):
        return f"codecs {json.dumps(codecs)[:240]}; bytes, blosc with zstd, and crc32c are read"
    lengths = [*shape, *shard, *chunk]
    if (
        len(shape) > 8
        or not len(shape) == len(shard) == len(chunk)
        or not all(type(n) is int and 0 <= n < MOST_LENGTH for n in lengths)
        or 0 in (*shard, *chunk)
    ):
        return f"lengths {str(shape)[:60]}, shards {str(shard)[:60]}, chunks {str(chunk)[:60]}"
    if any(s % c for s, c in zip(shard, chunk, strict=True)):
        return f"shards {shard} that are not whole chunks {chunk}"
    if math.prod(chunk) * size > MOST_CHUNK_BYTES or math.prod(shard) // math.prod(chunk) > MOST_CHUNKS:
        return f"chunks of {math.prod(chunk) * size / 1e9:.0f} GB, {math.prod(shard) // math.prod(chunk)} in a shard"
    shards = math.prod(-(-n // s) for n, s in zip(shape, shard, strict=True))
    return f"{shards} shards, at most {MOST_SHARDS} are read" if shards > MOST_SHARDS else None


def _is_bytes(codec: Any) -> bool:
    return codec in (
        {"name": "bytes"},
        {"name": "bytes", "configuration": {}},
        {"name": "bytes", "configuration": {"endian": "little"}},
    )


def _is_checksum(codec: Any) -> bool:
    return codec in ({"name": "crc32c"}, {"name": "crc32c", "configuration": {}})


def _is_blosc(codec: Any) -> bool:
    if codec.keys() != {"name", "configuration"} or codec["name"] != "blosc":
        return False
    own = codec["configuration"]
    numbers = [own.get(k) for k in ("clevel", "typesize", "blocksize")]
    known = (
        own.keys() == {"typesize", "cname", "clevel", "shuffle", "blocksize"}
        and own["cname"] == "zstd"
        and own["shuffle"] in ("noshuffle", "shuffle", "bitshuffle")
    )
    return (
        known
        and all(type(n) is int for n in numbers)
        and 0 <= own["clevel"] <= 9
        and 1 <= own["typesize"] <= 16
        and 0 <= own["blocksize"] < MOST_CHUNK_BYTES
    )
