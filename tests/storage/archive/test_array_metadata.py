"""What an array's description may say: as this program writes it, and nothing that would make foreign codecs or
absurd memory of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.array_metadata import ForeignArray, read_metadata, refuse_huge, values_digest
from posegaussian.storage.archive.shards import read_array
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import Unsafe
from posegaussian.storage.model.spec import ArraySpec, array_digest
from tests.support.sample_captures import make_sequence

DEPTH = ArraySpec("depth/depth", ("frame", "view", "y", "x"), "float32", "m", "Depth.")
SHAPE = {"frame": 10, "view": 3, "y": 6, "x": 8}
EVERY = {
    **SHAPE,
    "source_y": 6,
    "source_x": 8,
    "camera_y": 6,
    "camera_x": 8,
    "camera": 2,
    "joint": 17,
    "sample": 5,
    "person": 2,
    "one_view": 3,
    "other_view": 3,
    "found_joint": 33,
    "judged": 16,
    "moment": 6,
    "depth_method": 3,
    "weights": 2,
}


@pytest.fixture
def sequence(tmp_path: Path) -> SequenceGroup:
    made = make_sequence(tmp_path)
    made.ensure_array(DEPTH, SHAPE)
    return made


def test_every_array_that_is_written_is_read(sequence: SequenceGroup) -> None:
    for spec in (w for s in STAGES for w in s.writes if isinstance(w, ArraySpec)):
        sequence.ensure_array(spec, EVERY, "orbit-01234567")
    for dtype in ("bool", "uint8", "int32", "int64", "float16", "float32", "float64"):
        sequence.put(f"put/{dtype}", np.zeros((2, 3), dtype), ("a", "b"), "1", "x")
    sequence.put("put/none", np.zeros((0, 3)), ("a", "b"), "1", "x")
    for folder in sequence.walk_arrays():
        assert sequence.open_array(folder.relative_to(sequence.root).as_posix()).shape == tuple(
            read_metadata(folder)["shape"]
        )


def codecs(data: dict[str, Any]) -> list[Any]:
    return data["codecs"][0]["configuration"]["codecs"]


FOREIGN: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "version 2": (lambda d: d.update(zarr_format=2), "Zarr format 2"),
    "a group": (lambda d: d.update(node_type="group"), "group"),
    "an unknown codec": (
        lambda d: codecs(d).__setitem__(1, {"name": "numcodecs.pickle", "configuration": {}}),
        "numcodecs.pickle",
    ),
    "gzip": (lambda d: codecs(d).__setitem__(1, {"name": "gzip", "configuration": {"level": 5}}), "gzip"),
    "blosc of another kind": (lambda d: codecs(d)[1]["configuration"].update(cname="lz4"), "lz4"),
    "no checksum of chunks": (lambda d: codecs(d).pop(), "blosc with zstd, and crc32c are read"),
    "a codec before": (
        lambda d: codecs(d).insert(0, {"name": "transpose", "configuration": {"order": [0, 1, 2, 3]}}),
        "transpose",
    ),
    "shards in shards": (
        lambda d: codecs(d).__setitem__(0, json.loads(json.dumps(d["codecs"][0]))),
        "sharding_indexed",
    ),
    "another index": (
        lambda d: d["codecs"][0]["configuration"]["index_codecs"].__setitem__(0, {"name": "gzip"}),
        "codecs of the shards' index",
    ),
    "storage transformers": (lambda d: d.update(storage_transformers=[{"name": "evil"}]), "evil"),
    "unknown entries": (lambda d: d.update(consolidated_metadata={}), "consolidated_metadata"),
    "objects": (lambda d: d.update(data_type="object"), "object"),
    "a type with settings": (lambda d: d.update(data_type={"name": "numpy.datetime64"}), "datetime64"),
    "another fill value": (lambda d: d.update(fill_value="NaN"), "fill value"),
    "another naming of chunks": (
        lambda d: d["chunk_key_encoding"]["configuration"].update(separator="_"),
        "another naming of chunks",
    ),
    "absurd length": (lambda d: d.update(shape=[2**40, 3, 6, 8]), "lengths"),
    "negative length": (lambda d: d.update(shape=[-1, 3, 6, 8]), "lengths"),
    "length of another type": (lambda d: d.update(shape=[1e9, 3, 6, 8]), "lengths"),
    "absurd number of shards": (lambda d: d.update(shape=[2**30, 3, 6, 8]), "shards, at most"),
    "absurd chunk": (
        lambda d: (
            d["chunk_grid"]["configuration"].update(chunk_shape=[4, 1, 60000, 80000]),
            d["codecs"][0]["configuration"].update(chunk_shape=[1, 1, 60000, 80000]),
        ),
        "chunks of 19 GB",
    ),
    "absurd index": (
        lambda d: d["chunk_grid"]["configuration"].update(chunk_shape=[2**30, 1, 6, 8]),
        "1073741824 in a shard",
    ),
    "no chunk": (lambda d: d["codecs"][0]["configuration"].update(chunk_shape=[0, 1, 6, 8]), "lengths"),
    "lacks its codecs": (lambda d: d.pop("codecs"), "KeyError"),
    "names that do not fit": (lambda d: d.update(dimension_names=["a"]), "names of dimensions"),
    "no object": (lambda d: d.clear(), "Zarr format None"),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_descriptions_that_are_none_of_ours_are_refused_by_name(what: str, sequence: SequenceGroup) -> None:
    change, why = FOREIGN[what]
    file = sequence.root / "depth/depth/zarr.json"
    data = json.loads(file.read_bytes())
    del data["attributes"]["checksum"]
    change(data)
    file.write_text(json.dumps(data))
    with pytest.raises(ForeignArray) as refused:
        sequence.open_array("depth/depth")
    assert why in str(refused.value)
    assert str(file) in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"null", b"[" * 100_000, b"\xff", b'{"a": ' * 5000, b"1" * 5000])
def test_what_is_no_description_at_all_is_refused(content: bytes, sequence: SequenceGroup) -> None:
    (sequence.root / "depth/depth/zarr.json").write_bytes(content)
    with pytest.raises(ForeignArray, match="does not describe an array"):
        sequence.open_array("depth/depth")


def test_an_array_of_version_2_is_not_opened_in_place_of_ours(sequence: SequenceGroup) -> None:
    (sequence.root / "depth/depth/zarr.json").unlink()
    zarr.create_array(sequence.root / "depth/depth", shape=(3,), dtype="float32", zarr_format=2)
    with pytest.raises(FileNotFoundError):
        sequence.open_array("depth/depth")


def test_names_of_arrays_that_climb_are_refused(sequence: SequenceGroup) -> None:
    for name in ("../kick/depth/depth", "/etc", "depth//depth"):
        with pytest.raises(Unsafe):
            sequence.open_array(name)


def test_a_block_that_no_memory_holds_is_refused_before_it_is_made(sequence: SequenceGroup) -> None:
    refuse_huge("a", (1000, 1000), np.dtype("float32"))
    with pytest.raises(ForeignArray, match="is 4000 GB, this machine has"):
        refuse_huge("a", (10**6, 10**6), np.dtype("float32"))
    file = sequence.root / "depth/depth/zarr.json"
    data = json.loads(file.read_bytes())
    data["shape"] = [10, 3, 2**20, 2**20]
    del data["attributes"]["checksum"]
    data["chunk_grid"]["configuration"]["chunk_shape"] = [4, 1, 2**14, 2**14]
    data["codecs"][0]["configuration"]["chunk_shape"] = [1, 1, 2**14, 2**14]
    file.write_text(json.dumps(data))
    with pytest.raises(ForeignArray, match="of memory"):
        read_array(sequence, "depth/depth", DEPTH.dims, range(10), 0, ())


def test_the_digest_of_an_array_is_that_of_its_values_however_it_is_read(
    sequence: SequenceGroup, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.random.default_rng(0).normal(size=(7, 5, 3)).astype(np.float32)
    sequence.put("a", values, ("a", "b", "c"), "1", "x", chunk=(2, 5, 3))
    for part in (1, 100, 2**20):
        monkeypatch.setattr("posegaussian.storage.archive.array_metadata.PART_BYTES", part)
        assert values_digest(sequence.open_array("a")) == array_digest(values)
