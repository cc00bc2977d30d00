"""Which files an array's shards are: as the array's own description names them.

One file a shard in the array's folder, `c.0.1.0.0`. Arrays of earlier versions have a folder for every number,
`c/0/1/0/0`; they stay as they are, and what is added to them is named alike. Zarr takes a file that is not there for
zeros, so a name is never put together by rule: it is asked of the description, or compared with it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator
from itertools import product
from typing import Any

from posegaussian.storage.archive.array_metadata import read_metadata, separator
from posegaussian.storage.archive.receipts import Output, Receipt, ShardFile
from posegaussian.storage.archive.store import SequenceGroup


def shard_key(name: str, array: Any, where: tuple[int, ...]) -> str:
    """Key of the file of one shard of an open array; `where`: its number along every axis."""
    return f"{name}/{array.metadata.encode_chunk_key(where)}"


def keys_read(name: str, array: Any, index: tuple[int | slice, ...]) -> Iterator[str]:
    """Keys of all files that `array[index]` reads, index of whole numbers and slices without steps."""
    axes = []
    for i, n, s in zip(index, array.shape, array.shards or array.chunks, strict=True):
        wanted = range(n)[i] if isinstance(i, slice) else range(i, i + 1)
        axes.append(range(wanted.start // s, -(-wanted.stop // s)) if wanted else range(0))
    return (shard_key(name, array, where) for where in product(*axes))


def unpromised(name: str, array: Any, index: tuple[int | slice, ...], files: Collection[ShardFile]) -> str | None:
    """Key of a file that `array[index]` reads though it is none of `files`;
    None where it reads only what is promised."""
    promised = {f.key for f in files}
    return next((key for key in keys_read(name, array, index) if key not in promised), None)


def named_as_in(sequence: SequenceGroup, receipt: Receipt) -> Receipt:
    """A receipt of the same task elsewhere, with the keys that the shards have in this sequence's arrays.

    Tables keep theirs, and so do arrays that are not there. Raises ForeignArray.
    """
    return dataclasses.replace(receipt, outputs=tuple(_named(sequence, o) for o in receipt.outputs))


def _named(sequence: SequenceGroup, output: Output) -> Output:
    try:
        between = separator(read_metadata(sequence.place(output.array)))
    except FileNotFoundError:
        return output
    start = len(output.array) + 1
    files = (
        dataclasses.replace(f, key=f.key[:start] + f.key[start:].replace("/", ".").replace(".", between))
        for f in output.files
    )
    return dataclasses.replace(output, files=tuple(files))
