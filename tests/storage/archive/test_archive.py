"""Laws of an archive: how arrays are cut, grown and replaced; what is refused, and in which words."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import store as module
from posegaussian.storage.archive.array_metadata import ForeignArray
from posegaussian.storage.archive.records import ATTRIBUTES
from posegaussian.storage.archive.store import FORMAT, MAX_CHUNK_BYTES, Archive, SequenceGroup, layout, local_path
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ArchiveError, SourceError
from posegaussian.storage.model.spec import ArraySpec
from tests.support.sample_captures import make_capture, make_rig, make_sequence

QUICK = settings(max_examples=50)
SPECS = [w for s in STAGES for w in s.writes if isinstance(w, ArraySpec)]
DEPTH = ArraySpec("depth/depth", ("frame", "view", "y", "x"), "float32", "m", "Depth.")


MEASURED = {"judged": 16, "depth_method": 3, "weights": 2, "moment": 6, "found_joint": 33}


def shape_of(height: int, width: int, frames: int = 10) -> dict[str, int]:
    both = {"y": height, "x": width, "source_y": height, "source_x": width, "camera_y": height, "camera_x": width}
    return {
        **both,
        "frame": frames,
        "view": 3,
        "one_view": 3,
        "other_view": 3,
        "camera": 2,
        "joint": 25,
        "sample": 25,
        "person": 2,
        **MEASURED,
    }


@QUICK
@given(st.sampled_from(SPECS), st.integers(1, 4400), st.integers(1, 4400), st.integers(1, 40))
def test_a_chunk_is_at_most_one_frame_of_one_view_and_a_shard_one_partition_of_it(
    spec: ArraySpec, height: int, width: int, partition: int
) -> None:
    lengths, chunk, shard = layout(spec, shape_of(height, width), partition)
    assert math.prod(chunk) * np.dtype(spec.dtype).itemsize <= MAX_CHUNK_BYTES
    for dim, n, c, s in zip(spec.dims, lengths, chunk, shard, strict=True):
        assert s % c == 0, f"{dim}: shard {s} is not whole chunks of {c}"
        if dim == "frame":
            assert (c, s) == (1, partition)
        elif dim in ("view", "camera"):
            assert (c, s) == (1, 1)
        else:
            assert 0 <= s - n < s // c, f"{dim}: a shard must hold all {n}, at most a row a tile more, got {s}"


@pytest.mark.parametrize("height", [2160, 2161, 4319])
def test_pictures_of_odd_height_are_tiled_too(height: int) -> None:
    spec = next(s for s in SPECS if s.name == "frames/color")
    _, chunk, shard = layout(spec, shape_of(height, 3840), 4)
    assert math.prod(chunk) <= MAX_CHUNK_BYTES
    assert chunk[2] > height // 4, "tiles are as few as fit"
    assert shard[2] >= height


def test_bytes_are_shuffled_by_their_width_and_checksummed(tmp_path: Path) -> None:
    for dtype in ("float32", "float16", "uint8", "int64", "bool"):
        blosc, checksum = module.codecs(np.dtype(dtype))
        assert (blosc.shuffle.value, blosc.typesize) == ("shuffle", np.dtype(dtype).itemsize)
        assert type(checksum).__name__ == "Crc32cCodec"


def test_put_and_get_round_trip_and_putting_again_touches_no_file(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    rng = np.random.default_rng(0)
    for name, data in {
        "a/f": rng.normal(size=(3, 4)),
        "a/i": rng.integers(0, 9, 5).astype(np.int32),
        "a/b": rng.random(6) > 0.5,
        "a/zero": np.zeros((2, 2)),
    }.items():
        dims = tuple("abc"[: data.ndim])
        sequence.put(name, data, dims, "m", "x")
        got = sequence.get(name)
        assert got.dtype == data.dtype
        np.testing.assert_array_equal(got, data)
        stamps = {p: p.stat().st_mtime_ns for p in (sequence.root / name).rglob("*") if p.is_file()}
        sequence.put(name, data.copy(), dims, "m", "x")
        assert {p: p.stat().st_mtime_ns for p in (sequence.root / name).rglob("*") if p.is_file()} == stamps
        sequence.put(name, data[:1], dims, "m", "x")
        assert sequence.get(name).shape == data[:1].shape
    with pytest.raises(ArchiveError, match="sequence kick has no array a/none"):
        sequence.get("a/none")


def test_the_cameras_of_a_sequence_are_kept(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    rig = make_rig()
    assert sequence.name == "kick"
    assert sequence.partition_frames == 4
    assert sequence.capture.rig.digest == rig.digest
    np.testing.assert_array_equal(sequence.get("source/intrinsics"), rig.intrinsics)
    np.testing.assert_array_equal(sequence.get("source/world_to_camera"), rig.world_to_camera)
    np.testing.assert_array_equal(sequence.get("source/size"), rig.size)
    sequence.put_rig("frames", rig)
    np.testing.assert_array_equal(sequence.get("frames/intrinsics"), rig.intrinsics)


def fill(sequence: SequenceGroup, spec: ArraySpec, frames: int) -> np.ndarray:
    values = np.random.default_rng(1).normal(size=(frames, 3, 6, 8)).astype(np.float32)
    array = zarr.open_array(sequence.root / spec.name, mode="r+")
    array[...] = values
    return values


def files_of(sequence: SequenceGroup, spec: ArraySpec) -> dict[str, bytes]:
    folder = sequence.root / spec.name / "c"
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_ensuring_twice_changes_nothing(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    sequence.ensure_array(DEPTH, shape_of(6, 8))
    values, before = fill(sequence, DEPTH, 10), files_of(sequence, DEPTH)
    sequence.ensure_array(DEPTH, shape_of(6, 8))
    assert files_of(sequence, DEPTH) == before
    np.testing.assert_array_equal(sequence.get(DEPTH.name), values)


def test_growing_keeps_finished_shards_and_shrinking_those_that_remain(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    sequence.ensure_array(DEPTH, shape_of(6, 8, frames=10))
    values, before = fill(sequence, DEPTH, 10), files_of(sequence, DEPTH)
    sequence.ensure_array(DEPTH, shape_of(6, 8, frames=21))
    assert files_of(sequence, DEPTH) == before
    assert sequence.get(DEPTH.name).shape == (21, 3, 6, 8)
    np.testing.assert_array_equal(sequence.get(DEPTH.name)[:10], values)
    sequence.ensure_array(DEPTH, shape_of(6, 8, frames=8))
    assert files_of(sequence, DEPTH) == {k: v for k, v in before.items() if not k.startswith("2/")}
    np.testing.assert_array_equal(sequence.get(DEPTH.name), values[:8])


@pytest.mark.parametrize("change", ["height", "view", "dtype"])
def test_any_other_change_replaces_the_array(tmp_path: Path, change: str) -> None:
    sequence = make_sequence(tmp_path)
    sequence.ensure_array(DEPTH, shape_of(6, 8))
    fill(sequence, DEPTH, 10)
    shape = {"height": shape_of(7, 8), "view": {**shape_of(6, 8), "view": 4}, "dtype": shape_of(6, 8)}[change]
    sequence.ensure_array(replace(DEPTH, dtype="float16") if change == "dtype" else DEPTH, shape)
    assert files_of(sequence, DEPTH) == {}
    array = zarr.open_array(sequence.root / DEPTH.name, mode="r")
    assert array.metadata.dimension_names == DEPTH.dims
    assert {k: array.attrs[k] for k in array.attrs if k != "checksum"} == {
        "unit": "m",
        "meaning": "Depth.",
        "keep": "always",
    }


def test_an_array_is_opened_once_until_its_description_changes(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    sequence.ensure_array(DEPTH, shape_of(6, 8, frames=10))
    first = sequence.open_array(DEPTH.name)
    assert sequence.open_array(DEPTH.name) is first
    assert sequence.open_array(DEPTH.name, "r+") is not first, "one may write"
    with zarr.config.set({"array.write_empty_chunks": True}):
        assert sequence.open_array(DEPTH.name) is not first, "it writes otherwise"
    # another process makes it longer: the file is another one
    file = sequence.root / DEPTH.name / "zarr.json"
    text = file.read_text()
    array = zarr.open_array(file.parent, mode="r+")
    array.resize((21, *array.shape[1:]))
    with pytest.raises(ForeignArray):
        sequence.open_array(DEPTH.name)
    write_atomically(file, text.encode())
    assert sequence.open_array(DEPTH.name).shape == first.shape


def test_a_camera_path_fills_the_name(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    spec = next(s for s in SPECS if s.name == "rendering/{path}/alpha")
    sequence.ensure_array(spec, shape_of(6, 8), "orbit-01234567")
    found = [p.relative_to(sequence.root).as_posix() for p in sequence.walk_arrays()]
    assert "rendering/orbit-01234567/alpha" in found
    assert "source/intrinsics" in found


def rewrite_record(sequence: SequenceGroup, **changes: object) -> None:
    file = sequence.root / "zarr.json"
    meta = json.loads(file.read_bytes())
    meta["attributes"][ATTRIBUTES].update(changes)
    file.write_text(json.dumps(meta))


def test_a_newer_format_is_refused_with_both_numbers_and_the_next_step(tmp_path: Path) -> None:
    rewrite_record(make_sequence(tmp_path), format=FORMAT + 1)
    archive = Archive.open(str(tmp_path))
    with pytest.raises(
        ArchiveError,
        match=rf"kick is of archive format {FORMAT + 1}, this version reads up to {FORMAT}; update posegaussian",
    ):
        archive.sequence("kick")


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "null",
        "[]",
        '{"attributes": {}}',
        '{"attributes": {"posegaussian": 1}}',
        '{"attributes": {"posegaussian": {"format": "new"}}}',
    ],
)
def test_a_broken_record_gets_a_sentence(tmp_path: Path, content: str) -> None:
    sequence = make_sequence(tmp_path)
    (sequence.root / "zarr.json").write_text(content)
    with pytest.raises(ArchiveError, match="is not a sequence of a PoseGaussian archive"):
        Archive.open(str(tmp_path)).sequence("kick")


def test_an_unknown_sequence_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="it has: none yet"):
        Archive.open(str(tmp_path)).sequence("jump")
    make_sequence(tmp_path)
    with pytest.raises(ArchiveError, match="no sequence 'jump'; it has: kick"):
        Archive.open(str(tmp_path)).sequence("jump")


def test_a_missing_archive_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(
        ArchiveError, match=r"there is no archive at .*nowhere; `posegaussian import auto FOLDER` makes one"
    ):
        Archive.open(str(tmp_path / "nowhere"))
    assert Archive.open(str(tmp_path / "new"), create=True).names() == []


@pytest.mark.parametrize("url", ["s3://bucket/a", "gs://bucket/a", "https://host/a"])
def test_an_object_store_is_refused(url: str) -> None:
    with pytest.raises(ArchiveError, match=r"local or POSIX folder only; .* lack the conditional writes"):
        Archive.open(url)


def test_a_file_url_is_the_folder_it_names(tmp_path: Path) -> None:
    folder = tmp_path / "my archive"
    assert local_path(f"file://{folder}") == local_path(folder.as_uri()) == local_path(str(folder)) == folder


@pytest.mark.parametrize("name", ["", ".hidden", "_receipts", "a/b", "a\\b", "..", "c:d", "-x"])
def test_a_name_that_cannot_be_a_folder_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArchiveError, match="cannot be a folder's name"):
        Archive.open(str(tmp_path)).create_sequence(name, make_capture(), 4)
    assert list(tmp_path.iterdir()) == []


def test_a_record_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    """Nor does it take the place of one that can."""
    kept = make_sequence(tmp_path)
    good = make_capture()
    empty = replace(good.masks[0], files=(), numbers=())  # type: ignore[type-var]
    for broken in (
        replace(good, masks=(empty, *good.masks[1:])),
        replace(good, pictures=good.pictures[1:]),
        replace(good, held_out=("cam9",)),
    ):
        with pytest.raises(SourceError, match=r"the capture of layout images cannot be registered: .*nothing was wr"):
            Archive.open(str(tmp_path)).create_sequence("kick", broken, 4)
        with pytest.raises(SourceError):
            Archive.open(str(tmp_path)).create_sequence("other", broken, 4)
    assert Archive.open(str(tmp_path)).names() == ["kick"]
    assert Archive.open(str(tmp_path)).sequence("kick").capture.to_json() == kept.capture.to_json()


def test_the_catalogue_has_one_row_a_sequence(tmp_path: Path) -> None:
    archive = Archive.open(str(tmp_path))
    archive.create_sequence("walk", make_capture(2, range(5)), 8)
    archive.create_sequence("kick", make_capture(3, range(10)), 4)
    archive.create_sequence("kick", make_capture(3, range(12)), 4)
    rows = pq.read_table(tmp_path / "catalog.parquet").to_pylist()
    assert rows == [
        {"sequence": "kick", "layout": "images", "views": 3, "frames": 12, "frame_rate": 25.0, "partition_frames": 4},
        {"sequence": "walk", "layout": "images", "views": 2, "frames": 5, "frame_rate": 25.0, "partition_frames": 8},
    ]
    assert archive.names() == ["kick", "walk"]


def test_registering_again_keeps_results(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    sequence.ensure_array(DEPTH, shape_of(6, 8))
    values = fill(sequence, DEPTH, 10)
    again = Archive.open(str(tmp_path)).create_sequence("kick", make_capture(3, range(14)), 4)
    assert len(again.capture.numbers) == 14
    np.testing.assert_array_equal(again.get(DEPTH.name), values)


def test_a_sequence_is_never_visible_without_its_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kill right after the group's folder appears must leave a sequence that can be imported again."""

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SequenceGroup, "put", killed)
    with pytest.raises(KeyboardInterrupt):
        make_sequence(tmp_path)
    monkeypatch.undo()
    archive = Archive.open(str(tmp_path))
    assert all(archive.sequence(n).partition_frames == 4 for n in archive.names())
    make_sequence(tmp_path)
