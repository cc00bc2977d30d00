"""Laws of the names of shards: as the array's description says, in folders or not,
and never zeros where the two disagree."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.array_metadata import SHARD_NAMES, ForeignArray, copy_description, read_metadata
from posegaussian.storage.archive.chunk_keys import named_as_in
from posegaussian.storage.archive.integrity import Count, faults, repair
from posegaussian.storage.archive.receipts import Output, Receipt, damaged_files, scan_receipts, write_receipt
from posegaussian.storage.archive.shards import read_array, read_frames, write_array
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.model.errors import ShardMissing
from posegaussian.storage.model.timegrid import TimeGrid
from tests.storage.archive.test_shards import (
    DEPTH,
    FRAMES,
    GRID,
    PARTITION,
    SHAPE,
    VIEWS,
    block_of,
    make_values,
    write_all,
)
from tests.support.nested_archive import nest, nest_array, nest_description, nested_output, shards
from tests.support.sample_captures import make_sequence

VALUES = make_values(DEPTH)


@pytest.fixture
def sequence(tmp_path: Path) -> SequenceGroup:
    return make_sequence(tmp_path, VIEWS, PARTITION, range(FRAMES))


@pytest.fixture
def outputs(sequence: SequenceGroup) -> dict[tuple[int | None, int | None], Output]:
    """Depth, written whole, each output with a receipt of its own."""
    made = write_all(sequence, DEPTH, VALUES)
    for (partition, view), output in made.items():
        assert partition is not None
        write_receipt(
            sequence,
            Receipt(
                "depth",
                partition,
                view,
                None,
                f"f{partition}{view}",
                {"bounds": [list(GRID.bounds(partition))]},
                (output,),
            ),
        )
    return made


def promised(sequence: SequenceGroup) -> dict[tuple[int, int | None], Output]:
    return {(r.partition or 0, r.view): r.outputs[0] for r in scan_receipts(sequence)}


def assert_whole(sequence: SequenceGroup, values: np.ndarray = VALUES) -> None:
    grid = TimeGrid(len(values), PARTITION)
    for view in range(VIEWS):
        np.testing.assert_array_equal(
            read_frames(sequence, DEPTH.name, promised(sequence), grid, range(len(values)), view), values[:, view]
        )


def test_an_array_takes_one_folder_and_one_file_a_shard(sequence: SequenceGroup, outputs: dict) -> None:
    names = {p.name for p in (sequence.root / DEPTH.name).iterdir()}
    assert names == {"zarr.json", *(f"c.{p}.{v}.0.0" for p in GRID.partitions for v in range(VIEWS))}
    assert {p.name for p in (sequence.root / "source/size").iterdir()} == {"zarr.json", "c.0.0"}


def test_shards_in_folders_are_read_verified_and_written_again_where_they_lie(
    sequence: SequenceGroup, outputs: dict
) -> None:
    nest(sequence)
    assert_whole(sequence)
    np.testing.assert_array_equal(sequence.get("source/size"), sequence.capture.rig.size)
    assert list(faults(sequence, Count())) == []
    again = write_all(sequence, DEPTH, VALUES)
    assert again == {k: nested_output(o) for k, o in outputs.items()}
    assert shards(sequence.root)["flat"] == []
    assert_whole(sequence)


def test_an_array_of_shards_in_folders_grows_and_shrinks_as_it_is(sequence: SequenceGroup, outputs: dict) -> None:
    nest(sequence)
    longer = np.concatenate([VALUES, make_values(DEPTH, seed=1)[:6]])
    sequence.ensure_array(DEPTH, {**SHAPE, "frame": 16})
    grid = TimeGrid(16, PARTITION)
    for p in (2, 3):
        for v in range(VIEWS):
            own = grid.bounds(p)
            output = write_array(sequence, DEPTH, "", own, p, v, block_of(DEPTH, longer, own, v))
            assert [f.key for f in output.files] == [f"depth/depth/c/{p}/{v}/0/0"]
            write_receipt(sequence, Receipt("depth", p, v, None, "f", {"bounds": [list(own)]}, (output,)))
    assert_whole(sequence, longer)
    assert list(faults(sequence, Count())) == []
    sequence.ensure_array(DEPTH, {**SHAPE, "frame": 8})
    assert sorted(shards(sequence.root)["nested"]) == [
        f"depth/depth/c/{p}/{v}/0/0" for p in (0, 1) for v in range(VIEWS)
    ]
    np.testing.assert_array_equal(sequence.get(DEPTH.name), VALUES[:8])


def test_an_array_that_is_replaced_gets_one_file_a_shard(sequence: SequenceGroup, outputs: dict) -> None:
    nest_array(sequence.root / DEPTH.name)
    sequence.ensure_array(DEPTH, {**SHAPE, "x": 9})
    assert read_metadata(sequence.root / DEPTH.name)["chunk_key_encoding"] == SHARD_NAMES
    assert [p.name for p in (sequence.root / DEPTH.name).iterdir()] == ["zarr.json"]


@pytest.mark.parametrize("harm", ["description", "description and shards", "receipts"])
def test_where_receipt_and_description_disagree_nothing_is_read(
    harm: str, sequence: SequenceGroup, outputs: dict
) -> None:
    """Zarr would give zeros without a word."""
    folder = sequence.root / DEPTH.name
    if harm == "description and shards":
        shutil.copytree(folder, sequence.root / "copy")
        nest_array(folder)
        shutil.copytree(sequence.root / "copy", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("zarr.json"))
        shutil.rmtree(sequence.root / "copy")
    elif harm == "description":
        nest_description(folder)
    else:
        for shard in folder.glob("c.*"):
            place = folder / shard.name.replace(".", "/")
            place.parent.mkdir(parents=True, exist_ok=True)
            shard.rename(place)
        for receipt in list(scan_receipts(sequence)):
            write_receipt(sequence, dataclasses.replace(receipt, outputs=tuple(map(nested_output, receipt.outputs))))
    for view in range(VIEWS):
        with pytest.raises(
            ShardMissing,
            match=(
                r"depth/depth/c[./]0[./]\d[./]0[./]0 is read, which no receipt promises; .*verify --sequence kick"
                r" --repair"
            ),
        ):
            read_frames(sequence, DEPTH.name, promised(sequence), GRID, range(FRAMES), view)
    found = list(faults(sequence, Count()))
    assert len(found) == len(outputs)
    assert all("is read instead" in f.cause for f in found)
    for fault in found:
        repair(sequence, fault)
    assert promised(sequence) == {}, "the next run makes them anew, named as the description says"
    for (p, v), output in write_all(sequence, DEPTH, VALUES).items():
        write_receipt(sequence, Receipt("depth", p, v, None, "f", {"bounds": [list(GRID.bounds(p or 0))]}, (output,)))
    assert_whole(sequence)


def test_only_what_the_receipts_promise_is_read(sequence: SequenceGroup, outputs: dict) -> None:
    """A file of another partition or view is none of those that are read."""
    for wrong in ((), outputs[1, 0].files, outputs[0, 1].files):
        with pytest.raises(ShardMissing, match=r"c\.0\.0\.0\.0 is read, which no receipt promises"):
            read_array(sequence, DEPTH.name, DEPTH.dims, range(2), 0, wrong)
    with pytest.raises(ShardMissing, match=r"c\.1\.0\.0\.0 is read"):
        read_array(sequence, DEPTH.name, DEPTH.dims, range(2, 5), 0, outputs[0, 0].files)


@pytest.mark.parametrize("before", ["nested", "flat"])
def test_results_put_aside_come_back_under_the_names_of_the_array_that_is_there(
    before: str, sequence: SequenceGroup, outputs: dict
) -> None:
    if before == "nested":
        nest(sequence)
    receipts = list(scan_receipts(sequence))
    assert set_aside.put(sequence, receipts)
    shutil.rmtree(sequence.root / DEPTH.name)
    sequence.ensure_array(DEPTH, SHAPE)
    if before == "flat":
        nest_array(sequence.root / DEPTH.name)
    for r in receipts:
        taken = set_aside.take(sequence, set_aside.key_of(r), r.fingerprint, "run", 60.0)
        assert taken is not None
        assert taken.contents == r.contents
        assert damaged_files(sequence, taken) == []
    assert_whole(sequence)
    assert list(faults(sequence, Count())) == []
    assert shards(sequence.root)[before] == []


def test_a_description_that_is_copied_leaves_the_names_of_shards_that_are_there(
    sequence: SequenceGroup, outputs: dict, tmp_path: Path
) -> None:
    other = make_sequence(tmp_path / "other", VIEWS, PARTITION, range(FRAMES))
    source, folder = sequence.root / DEPTH.name, other.root / DEPTH.name
    copy_description(source, folder)
    assert (folder / "zarr.json").read_bytes() == (source / "zarr.json").read_bytes()
    nest_array(folder)
    own = read_metadata(folder)
    copy_description(source, folder)
    assert read_metadata(folder) == own
    (source / "zarr.json").write_text("{}")
    with pytest.raises(ForeignArray):
        copy_description(source, folder)


def test_receipts_of_elsewhere_are_named_as_the_arrays_here(
    sequence: SequenceGroup, outputs: dict, tmp_path: Path
) -> None:
    table = Output("metrics/a.b", None, "d", ())
    for array in (DEPTH.name, "rendering/c.1/color"):
        (sequence.root / array).mkdir(parents=True, exist_ok=True)
        if array != DEPTH.name:
            copy_description(sequence.root / DEPTH.name, sequence.root / array)
    keys = {DEPTH.name: "c.0.1.0.0", "rendering/c.1/color": "c.0.1.0.0"}
    made = tuple(
        dataclasses.replace(
            outputs[0, 1], array=a, files=(dataclasses.replace(outputs[0, 1].files[0], key=f"{a}/{k}"),)
        )
        for a, k in keys.items()
    )
    receipt = Receipt("depth", 0, 1, None, "f", {}, (*made, table))
    assert named_as_in(sequence, receipt) == receipt
    for array in keys:
        nest_array(sequence.root / array)
    own = named_as_in(sequence, receipt)
    assert [f.key for o in own.outputs for f in o.files] == ["depth/depth/c/0/1/0/0", "rendering/c.1/color/c/0/1/0/0"]
    assert named_as_in(sequence, own) == own
    elsewhere = Archive.open(str(tmp_path / "new"), create=True).create_sequence("kick", sequence.capture, PARTITION)
    assert named_as_in(elsewhere, own) == own, "arrays that are not there name nothing"
