"""Archives as earlier versions made them:
a folder for every number of a shard, `c/0/1/0/0` where it is now `c.0.1.0.0`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from posegaussian.storage.archive.array_metadata import NESTED_NAMES, read_metadata, seal
from posegaussian.storage.archive.receipts import Output, Receipt, scan_receipts, write_receipt
from posegaussian.storage.archive.store import SequenceGroup


def nest_description(folder: Path) -> None:
    """Only the description of an array says that shards are nested; they lie as before."""
    found = read_metadata(folder)
    (folder / "zarr.json").write_text(json.dumps({**found, "chunk_key_encoding": NESTED_NAMES}))
    seal(folder)


def nest_array(folder: Path) -> None:
    """One array as it was: its description, and its shards in folders."""
    for shard in folder.glob("c.*"):
        place = folder / shard.name.replace(".", "/")
        place.parent.mkdir(parents=True, exist_ok=True)
        shard.rename(place)
    nest_description(folder)


def nested(receipt: Receipt) -> Receipt:
    """A receipt as it was."""
    return dataclasses.replace(receipt, outputs=tuple(map(nested_output, receipt.outputs)))


def nested_output(output: Output) -> Output:
    """An output as it was; a table's stays."""
    files = (
        (
            dataclasses.replace(
                f, key=output.array + f.key.removeprefix(output.array).replace("/c.", "/c/").replace(".", "/")
            )
            if "/c." in f.key
            else f
        )
        for f in output.files
    )
    return dataclasses.replace(output, files=tuple(files))


def nest(sequence: SequenceGroup) -> SequenceGroup:
    """A whole sequence as it was, arrays and receipts."""
    for folder in list(sequence.walk_arrays()):
        nest_array(folder)
    for receipt in list(scan_receipts(sequence)):
        write_receipt(sequence, nested(receipt))
    return sequence


def shards(root: Path) -> dict[str, list[str]]:
    """{nested or flat: keys} of all shards below a sequence's folder, its cameras left out."""
    keys = [
        p.relative_to(root).as_posix()
        for p in root.rglob("*")
        if p.is_file() and ("/c/" in p.as_posix() or p.name.startswith("c."))
    ]
    return {
        "nested": [k for k in keys if "/c/" in k and not k.startswith("source/")],
        "flat": [k for k in keys if "/c." in k and not k.startswith("source/")],
    }
