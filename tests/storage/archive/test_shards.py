"""Laws of shards: what is written is read, wrong blocks are refused, and damage is an error, never zeros."""

from __future__ import annotations

import errno
import resource
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.dags.runtime.failures import Kind, classify
from posegaussian.storage.archive import store
from posegaussian.storage.archive.receipts import Output
from posegaussian.storage.archive.shards import read_array, read_frames, write_array, write_table
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import NotWritten, ShardCorrupt, ShardMissing, UserError
from posegaussian.storage.model.spec import LISTED, ArraySpec, TableSpec, content_digest
from posegaussian.storage.model.timegrid import TimeGrid
from tests.support.sample_captures import make_sequence

FRAMES, VIEWS, HEIGHT, WIDTH, PARTITION = 10, 2, 5, 7, 4
GRID = TimeGrid(FRAMES, PARTITION)
SHAPE = {"frame": FRAMES, "view": VIEWS, "y": HEIGHT, "x": WIDTH, "joint": 3}
DEPTH = ArraySpec("depth/depth", ("frame", "view", "y", "x"), "float32", "m", "Depth.")
COLOR = ArraySpec("frames/color", ("frame", "view", "y", "x", "rgb"), "uint8", "sRGB", "Colour.")
JOINTS = ArraySpec("pose/joints3d", ("frame", "joint", "xyzs"), "float32", "m", "Joints.")
PLATE = ArraySpec("survey/plate", ("view", "y", "x", "rgb"), "uint8", "sRGB", "Plate.")
ALL = (DEPTH, COLOR, JOINTS, PLATE)

Outputs = dict[tuple[int | None, int | None], Output]


def make_values(spec: ArraySpec, frames: int = FRAMES, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    lengths = spec.lengths({**SHAPE, "frame": frames})
    return (
        rng.normal(size=lengths).astype(np.float32)
        if spec.dtype == "float32"
        else rng.integers(0, 256, lengths).astype(spec.dtype)
    )


def write_all(sequence: SequenceGroup, spec: ArraySpec, values: np.ndarray, frames: int = FRAMES) -> Outputs:
    """Write an array partition by partition and view by view, as tasks do."""
    sequence.ensure_array(spec, {**SHAPE, "frame": frames})
    grid, outputs = TimeGrid(frames, sequence.partition_frames), {}
    for p in grid.partitions if spec.per_frame else [None]:
        own = grid.bounds(p) if p is not None else range(0)
        for v in range(VIEWS) if spec.per_view else [None]:
            outputs[p, v] = write_array(sequence, spec, "", own, p, v, block_of(spec, values, own, v))
    return outputs


def block_of(spec: ArraySpec, values: np.ndarray, span: range, view: int | None) -> np.ndarray:
    if spec.per_frame:
        values = values[span.start : span.stop]
    return np.take(values, view, axis=spec.dims.index("view")) if spec.per_view else values


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[SequenceGroup, dict[str, tuple[np.ndarray, Outputs]]]:
    sequence = make_sequence(tmp_path_factory.mktemp("shards"), VIEWS, PARTITION, range(FRAMES))
    found = {}
    for spec in ALL:
        values = make_values(spec)
        found[spec.name] = (values, write_all(sequence, spec, values))
    return sequence, found


@settings(max_examples=40)
@given(st.sampled_from(ALL), st.integers(0, FRAMES - 1), st.integers(1, FRAMES), st.integers(0, VIEWS - 1))
def test_any_span_of_any_view_reads_what_was_written(
    written: tuple[SequenceGroup, dict], spec: ArraySpec, start: int, length: int, view: int
) -> None:
    sequence, found = written
    values, outputs = found[spec.name]
    span = range(start, min(start + length, FRAMES))
    v = view if spec.per_view else None
    partitions = GRID.touched(span) if spec.per_frame else [None]
    files = [f for p in partitions for f in outputs[p, v].files]
    got = read_array(sequence, spec.name, spec.dims, span, v, files)
    wanted = block_of(spec, values, span, v)
    assert got.dtype == wanted.dtype
    np.testing.assert_array_equal(got, wanted)
    if spec.per_frame:
        np.testing.assert_array_equal(read_frames(sequence, spec.name, outputs, GRID, span, v), wanted)


@settings(max_examples=6)
@given(st.integers(1, 9), st.integers(1, 5), st.integers(0, 99))
def test_every_partition_length_holds_the_same_content(frames: int, partition: int, seed: int) -> None:
    values = make_values(DEPTH, frames, seed)
    with tempfile.TemporaryDirectory() as folder:
        sequence = make_sequence(Path(folder), VIEWS, partition, range(frames))
        outputs = write_all(sequence, DEPTH, values, frames)
        np.testing.assert_array_equal(sequence.get(DEPTH.name), values)
        files = [f.key for o in outputs.values() for f in o.files]
        on_disk = [p.relative_to(sequence.root).as_posix() for p in (sequence.root / DEPTH.name).glob("c.*")]
        assert sorted(files) == sorted(on_disk), "a receipt names every file of its output, each once"


def test_tiled_pictures_round_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "MAX_CHUNK_BYTES", 2 * WIDTH * 4)
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    outputs = write_all(sequence, DEPTH, values)
    assert {len(o.files) for o in outputs.values()} == {1}
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), 1), values[:, 1])


def test_zeros_are_written_not_left_out(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    outputs = write_all(sequence, DEPTH, np.zeros_like(make_values(DEPTH)))
    for output in outputs.values():
        for f in output.files:
            assert (sequence.root / f.key).stat().st_size == f.size > 0


def test_zeros_are_written_after_threads_opened_arrays_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    outputs = write_all(sequence, DEPTH, values)
    opened, second_inside, inside = SequenceGroup.open_array, threading.Event(), []

    def together(self: SequenceGroup, name: str, mode: Literal["r", "r+"] = "r") -> Any:
        inside.append(threading.get_ident())
        if len(set(inside)) == 1:
            second_inside.wait(0.2)  # in vain where the other one waits until this one is out, as it must
        else:
            second_inside.set()
            time.sleep(0.2)  # the first one is out before
        return opened(self, name, mode)

    with monkeypatch.context() as patch, ThreadPoolExecutor(2) as threads:
        patch.setattr(SequenceGroup, "open_array", together)
        for got in threads.map(lambda v: read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), v), (0, 1)):
            assert got.shape == (FRAMES, HEIGHT, WIDTH)
    for output in write_all(sequence, DEPTH, np.zeros_like(values)).values():
        for f in output.files:
            assert (sequence.root / f.key).stat().st_size == f.size > 0


def test_equal_content_gives_equal_digests_and_equal_files_anywhere(tmp_path: Path) -> None:
    first = make_sequence(tmp_path / "a", VIEWS, PARTITION, range(FRAMES))
    second = make_sequence(tmp_path / "b", VIEWS, PARTITION, range(FRAMES))
    values = make_values(COLOR)
    one = write_all(first, COLOR, values)
    write_all(second, COLOR, 255 - values)
    assert write_all(first, COLOR, values) == one
    assert write_all(second, COLOR, np.asfortranarray(values)) == one, "what lay there before leaves no trace"
    for f in one[1, 0].files:
        assert (first.root / f.key).read_bytes() == (second.root / f.key).read_bytes()


def test_other_content_changes_only_its_own_digest(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    before = write_all(sequence, DEPTH, values)
    values[5, 1, 0, 0] += 1
    after = write_all(sequence, DEPTH, values)
    assert [k for k in before if before[k].digest != after[k].digest] == [(1, 1)]


def test_a_rewritten_shorter_partition_forgets_the_frames_it_lost(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    write_all(sequence, DEPTH, values)
    shorter = write_all(sequence, DEPTH, values[:6], 6)
    fresh = make_sequence(tmp_path / "fresh", VIEWS, PARTITION, range(6))
    assert write_all(fresh, DEPTH, values[:6], 6) == shorter


def test_frames_beyond_the_last_are_missing_and_never_left_out(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    outputs = write_all(sequence, DEPTH, values[:6], 6)
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(4, 6), 0), values[4:6, 0])
    for span in (range(4, 8), range(6, 7)):
        with pytest.raises(ShardMissing, match=rf"has 6 frames, and {span[0]}\.\.{span[-1]} .* run again"):
            read_frames(sequence, DEPTH.name, outputs, GRID, span, 0)


BAD_BLOCKS = {
    "one frame too few": (lambda b: b[1:], 0),
    "a view axis too many": (lambda b: b[:, None], 0),
    "another height": (lambda b: b[:, 1:], 0),
    "float64": (lambda b: b.astype(np.float64), 0),
    "no view": (lambda b: b, None),
    "a view beyond the last": (lambda b: b, VIEWS),
    "a negative view": (lambda b: b, -1),
}


@pytest.mark.parametrize("fault", BAD_BLOCKS)
def test_a_block_that_is_not_as_declared_is_refused_and_harms_nothing(tmp_path: Path, fault: str) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    outputs = write_all(sequence, DEPTH, values)
    change, view = BAD_BLOCKS[fault]
    with pytest.raises(ValueError, match="depth/depth: got"):
        write_array(sequence, DEPTH, "", GRID.bounds(0), 0, view, change(values[:4, 0]))
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), 0), values[:, 0])


def test_a_view_for_an_array_without_views_is_refused(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    sequence.ensure_array(JOINTS, SHAPE)
    with pytest.raises(ValueError, match="no views"):
        write_array(sequence, JOINTS, "", GRID.bounds(0), 0, 1, make_values(JOINTS)[:4])


@pytest.fixture
def damaged(tmp_path: Path) -> tuple[SequenceGroup, np.ndarray, Outputs]:
    sequence = make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))
    values = make_values(DEPTH)
    return sequence, values, write_all(sequence, DEPTH, values)


def shard(sequence: SequenceGroup, output: Output) -> Path:
    (f,) = output.files
    return sequence.root / f.key


def test_a_deleted_shard_is_missing(damaged: tuple[SequenceGroup, np.ndarray, Outputs]) -> None:
    sequence, values, outputs = damaged
    shard(sequence, outputs[1, 1]).unlink()
    with pytest.raises(ShardMissing, match=r"depth/depth/c.1.1.0.0 of sequence kick is missing; run again"):
        read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), 1)
    assert issubclass(ShardMissing, UserError)
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(4), 1), values[:4, 1])
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), 0), values[:, 0])


@pytest.mark.parametrize("keep", [0, 1, -1])
def test_a_truncated_or_emptied_shard_is_corrupt(damaged: tuple[SequenceGroup, np.ndarray, Outputs], keep: int) -> None:
    sequence, _, outputs = damaged
    path = shard(sequence, outputs[1, 1])
    data = path.read_bytes()
    path.write_bytes(data[:keep])
    with pytest.raises(ShardCorrupt, match=rf"has {len(data[:keep])} bytes, its receipt says {len(data)}; run again"):
        read_frames(sequence, DEPTH.name, outputs, GRID, range(4, 8), 1)


def test_one_flipped_bit_anywhere_in_a_shard_is_noticed(damaged: tuple[SequenceGroup, np.ndarray, Outputs]) -> None:
    """Chunk data, chunk checksums and the shard's index: 40 places spread over the file, size kept."""
    sequence, values, outputs = damaged
    path = shard(sequence, outputs[1, 0])
    data = path.read_bytes()
    for place in np.linspace(0, len(data) - 1, 40).astype(int):
        broken = bytearray(data)
        broken[place] ^= 1 << (place % 8)
        path.write_bytes(bytes(broken))
        with pytest.raises(
            ShardCorrupt, match=r"depth/depth of sequence kick, frames 4\.\.7 \(counted from 0\), view 0"
        ):
            read_frames(sequence, DEPTH.name, outputs, GRID, range(4, 8), 0)
    path.write_bytes(data)
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(4, 8), 0), values[4:8, 0])


def test_a_shard_of_zeros_is_corrupt(damaged: tuple[SequenceGroup, np.ndarray, Outputs]) -> None:
    sequence, _, outputs = damaged
    path = shard(sequence, outputs[0, 0])
    path.write_bytes(bytes(path.stat().st_size))
    with pytest.raises(ShardCorrupt):
        read_frames(sequence, DEPTH.name, outputs, GRID, range(4), 0)


def test_a_system_that_takes_no_more_bytes_of_a_shard_is_a_sentence(
    damaged: tuple[SequenceGroup, np.ndarray, Outputs],
) -> None:
    """The compiled library says it in its own way, which is that of damage."""
    sequence, values, _ = damaged
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, before[1]))
    try:
        with pytest.raises(
            NotWritten, match=r"cannot write .*c\.0\.0\.0\.0: it is larger than files may become"
        ) as told:
            write_array(sequence, DEPTH, "", GRID.bounds(0), 0, 0, values[:4, 0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert told.value.errno == errno.EFBIG


@pytest.mark.parametrize(("said", "number"), [("Input/output error", errno.EIO), ("Stale file handle", errno.ESTALE)])
def test_a_disk_that_stumbles_over_a_shard_is_no_damage(
    damaged: tuple[SequenceGroup, np.ndarray, Outputs], monkeypatch: pytest.MonkeyPatch, said: str, number: int
) -> None:
    sequence, values, outputs = damaged
    with monkeypatch.context() as patch:
        patch.setattr(zarr.Array, "__getitem__", Mock(side_effect=RuntimeError(f"{said} (os error {number})")))
        with pytest.raises(OSError) as told:
            read_frames(sequence, DEPTH.name, outputs, GRID, range(4), 0)
    assert told.value.errno == number
    assert classify(told.value) is Kind.TRANSIENT
    np.testing.assert_array_equal(read_frames(sequence, DEPTH.name, outputs, GRID, range(4), 0), values[:4, 0])


def test_a_partition_without_a_receipt_is_missing_even_if_its_shard_is_there(
    damaged: tuple[SequenceGroup, np.ndarray, Outputs],
) -> None:
    sequence, _, outputs = damaged
    del outputs[2, 0]
    with pytest.raises(ShardMissing, match="no finished partition 2"):
        read_frames(sequence, DEPTH.name, outputs, GRID, range(FRAMES), 0)


TABLE = TableSpec("metrics/{path}", (("camera", "string"), ("frame", "int64"), ("value", "float64")), "A measure.")


def test_a_table_is_read_as_written_and_known_by_its_content(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    columns = {"camera": ["a", "b"], "frame": [0, 1], "value": [1.5, float("inf")]}
    output = write_table(sequence, TABLE, "orbit-1", 3, columns)
    assert output.array == "metrics/orbit-1"
    assert [f.key for f in output.files] == ["metrics/orbit-1/p000003.parquet"]
    assert pq.read_table(sequence.root / output.files[0].key).to_pydict() == columns
    assert write_table(sequence, TABLE, "orbit-1", 3, columns) == output
    assert write_table(sequence, TABLE, "orbit-1", 3, {**columns, "value": [1.5, float("nan")]}).digest != output.digest
    assert write_table(sequence, TABLE, "orbit-1", None, columns).files[0].key == "metrics/orbit-1/all.parquet"
    empty = write_table(sequence, TABLE, "orbit-1", 4, {"camera": [], "frame": [], "value": []})
    assert pq.read_table(sequence.root / empty.files[0].key).schema.names == ["camera", "frame", "value"]


@pytest.mark.parametrize(
    "columns",
    [
        {"camera": ["a"], "frame": [0]},
        {"frame": [0], "camera": ["a"], "value": [0.0]},
        {"camera": ["a"], "frame": ["x"], "value": [0.0]},
    ],
)
def test_a_table_that_is_not_as_declared_is_refused(tmp_path: Path, columns: dict) -> None:
    with pytest.raises(ValueError):
        write_table(make_sequence(tmp_path), TABLE, "orbit-1", 0, columns)


def test_the_path_of_a_task_fills_the_name_of_its_array(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    spec = replace(JOINTS, name="rendering/{path}/joints")
    sequence.ensure_array(spec, SHAPE, "still-1")
    output = write_array(sequence, spec, "still-1", GRID.bounds(2), 2, None, make_values(JOINTS)[8:])
    assert output.array == "rendering/still-1/joints"
    assert output.files[0].key == "rendering/still-1/joints/c.2.0.0"


LISTS = ArraySpec("refinement/twist", ("frame", "view", LISTED, "turn"), "float16", "1", "Turns.")
PIXELS = HEIGHT * WIDTH


@settings(max_examples=20)
@given(st.lists(st.integers(0, PIXELS), min_size=PARTITION, max_size=PARTITION), st.integers(0, PIXELS), st.data())
def test_of_a_list_what_is_used_is_kept_and_the_rest_is_zero(
    lengths: list[int], more: int, data: st.DataObject
) -> None:
    """However many zeros were written after its last entry, and however many entries are read."""
    used, first = max(lengths), data.draw(st.integers(0, PIXELS))
    rng, whole = np.random.default_rng(sum(lengths)), np.zeros((PARTITION, PIXELS, 2), np.float16)
    for own, n in zip(whole, lengths, strict=True):
        own[:n] = rng.uniform(0.5, 1, (n, 2))
    with tempfile.TemporaryDirectory() as folder:
        sequence = make_sequence(Path(folder), VIEWS, PARTITION, range(FRAMES))
        sequence.ensure_array(LISTS, SHAPE)
        written = whole[:, : min(PIXELS, used + more)]
        made = write_array(sequence, LISTS, "", range(PARTITION), 0, 1, written)
        assert made.digest == content_digest(whole, ("frame", LISTED, "turn"))
        read = read_array(sequence, LISTS.name, LISTS.dims, range(PARTITION), 1, made.files, first)
        np.testing.assert_array_equal(read, whole[:, :first])
        again = read_array(sequence, LISTS.name, LISTS.dims, range(1, PARTITION), 1, made.files)
        np.testing.assert_array_equal(again, whole[1:])
        for shape in ((PARTITION, PIXELS + 1, 2), (PARTITION, PIXELS), (PARTITION,)):
            with pytest.raises(ValueError, match="declared"):
                write_array(sequence, LISTS, "", range(PARTITION), 0, 1, np.zeros(shape, np.float16))


def test_pieces_of_a_list_that_nobody_uses_are_not_stored(tmp_path: Path) -> None:
    """A long list with a few entries takes hardly more bytes than a short one."""
    size = {}
    for side in (64, 512):
        sequence = make_sequence(tmp_path / str(side), VIEWS, PARTITION, range(FRAMES))
        sequence.ensure_array(LISTS, SHAPE | {"y": side, "x": side})
        entries = np.random.default_rng(0).normal(size=(PARTITION, 60, 2)).astype(np.float16)
        (file,) = write_array(sequence, LISTS, "", range(PARTITION), 0, 0, entries).files
        size[side] = file.size
    assert size[512] < 1.2 * size[64], "64 entries of its index a frame, of 16 bytes each, are there in both"
