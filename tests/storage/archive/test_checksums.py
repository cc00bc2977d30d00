"""Laws of checksums: a changed digit is noticed before anything follows it;
what has none yet is accepted and gets one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.archive import checksums
from posegaussian.storage.archive.array_metadata import ForeignArray, is_sealed, read_metadata, seal
from posegaussian.storage.archive.integrity import Count, faults, repair, seal_all
from posegaussian.storage.archive.receipts import Receipt, scan_receipts, write_receipt
from posegaussian.storage.archive.records import ATTRIBUTES, write_record
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, BrokenRecord
from posegaussian.storage.model.spec import ArraySpec
from tests.support.sample_captures import make_capture, make_sequence

DEPTH = ArraySpec("depth/depth", ("frame", "view", "y", "x"), "float32", "m", "Depth.")
SHAPE = {"frame": 10, "view": 3, "y": 6, "x": 8}


@pytest.fixture
def sequence(tmp_path: Path) -> SequenceGroup:
    made = make_sequence(tmp_path)
    made.ensure_array(DEPTH, SHAPE)
    made.put_rig("frames", made.capture.rig)
    return made


def again(sequence: SequenceGroup) -> SequenceGroup:
    return Archive.open(str(sequence.root.parent)).sequence(sequence.name)


def edit(file: Path, change: Callable[[Any], object]) -> None:
    data = json.loads(file.read_bytes())
    change(data)
    file.write_text(json.dumps(data))


def causes(sequence: SequenceGroup) -> list[str]:
    return [f"{f.file}: {f.cause}" for f in faults(again(sequence), Count())]


CHANGES: dict[str, Callable[[Any], object]] = {
    "focal length": lambda r: r["capture"]["rig"]["intrinsics"][0][0].__setitem__(0, 51.0),
    "position": lambda r: r["capture"]["rig"]["world_to_camera"][1][2].__setitem__(3, 3.0001),
    "size": lambda r: r["capture"]["rig"]["size"][0].__setitem__(0, 41),
    "name": lambda r: r["capture"]["rig"]["names"].__setitem__(0, "cam1"),
    "frame rate": lambda r: r["capture"].__setitem__("frame_rate", 24.0),
    "digest of a source": lambda r: r["capture"]["pictures"][0]["files"][0].__setitem__("sha256", "0" * 64),
    "partition": lambda r: r.__setitem__("partition_frames", 5),
    "checksum": lambda r: r.__setitem__("checksum", "0" * 32),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_in_the_record_is_refused_with_the_file_and_what_to_do(what: str, sequence: SequenceGroup) -> None:
    edit(sequence.root / "zarr.json", lambda data: CHANGES[what](data["attributes"][ATTRIBUTES]))
    with pytest.raises(
        BrokenRecord,
        match=r"kick/zarr\.json changed since it was written.*put the old file back, or import the capture again",
    ):
        again(sequence)


def test_importing_again_makes_a_changed_record_whole(sequence: SequenceGroup, tmp_path: Path) -> None:
    edit(sequence.root / "zarr.json", lambda data: CHANGES["size"](data["attributes"][ATTRIBUTES]))
    Archive.open(str(tmp_path)).create_sequence("kick", make_capture(), 4)
    assert again(sequence).capture.rig.size[0, 0] == 40


def test_attributes_of_others_stay_and_do_not_count(sequence: SequenceGroup) -> None:
    edit(sequence.root / "zarr.json", lambda data: data["attributes"].__setitem__("mine", 1))
    write_record(sequence.root, again(sequence).record)
    assert json.loads((sequence.root / "zarr.json").read_bytes())["attributes"]["mine"] == 1
    assert again(sequence).partition_frames == 4


def test_an_archive_of_before_is_accepted_and_sealed_as_it_is(sequence: SequenceGroup) -> None:
    edit(sequence.root / "zarr.json", lambda data: data["attributes"][ATTRIBUTES].pop("checksum"))
    for folder in sequence.walk_arrays():
        edit(folder / "zarr.json", lambda data: [data["attributes"].pop(k, None) for k in ("checksum", "digest")])
    old, count = again(sequence), Count()
    assert old.capture.rig.digest == sequence.capture.rig.digest
    assert list(faults(old, count)) == []
    arrays = len(list(old.walk_arrays()))
    assert count.unsealed == 1 + arrays
    assert seal_all(old) == 1 + arrays
    assert seal_all(again(sequence)) == 0
    edit(sequence.root / "zarr.json", lambda data: CHANGES["focal length"](data["attributes"][ATTRIBUTES]))
    with pytest.raises(BrokenRecord, match="changed since"):
        again(sequence)


def test_writing_an_array_of_before_again_seals_it_and_keeps_its_bytes(sequence: SequenceGroup) -> None:
    folder = sequence.root / "frames/intrinsics"
    edit(folder / "zarr.json", lambda data: [data["attributes"].pop(k) for k in ("checksum", "digest")])
    before = {p: p.stat().st_mtime_ns for p in folder.glob("c.*")}
    sequence.put_rig("frames", sequence.capture.rig)
    assert is_sealed(folder)
    assert "digest" in read_metadata(folder)["attributes"]
    assert {p: p.stat().st_mtime_ns for p in folder.glob("c.*")} == before


@pytest.mark.parametrize(
    "change",
    [
        {"shape": [10, 3, 6, 9]},
        {"data_type": "int32"},
        {"fill_value": 1.0},
        {"dimension_names": ["frame", "view", "x", "y"]},
        {"attributes": {"unit": "mm", "checksum": "0" * 32}},
    ],
)
def test_a_change_in_a_description_is_refused_and_named(change: dict[str, Any], sequence: SequenceGroup) -> None:
    edit(sequence.root / "depth/depth/zarr.json", lambda data: data.update(change))
    with pytest.raises(ForeignArray, match=r"depth/depth/zarr\.json does not describe.*verify --repair"):
        sequence.open_array("depth/depth")
    (said,) = causes(sequence)
    assert said.startswith("depth/depth/zarr.json: an array that cannot be read as it was written")


@pytest.mark.parametrize("frames", [21, 8])
def test_growing_and_shrinking_seal_anew(frames: int, sequence: SequenceGroup) -> None:
    sequence.ensure_array(DEPTH, {**SHAPE, "frame": frames})
    assert is_sealed(sequence.root / "depth/depth")
    assert sequence.open_array("depth/depth").shape[0] == frames


def test_a_kill_while_an_array_grows_leaves_one_that_can_be_read(
    sequence: SequenceGroup, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Death(BaseException):
        pass

    def die(*_: object) -> None:
        raise Death

    monkeypatch.setattr("posegaussian.storage.archive.store.seal", die)
    with pytest.raises(Death):
        sequence.ensure_array(DEPTH, {**SHAPE, "frame": 21})
    monkeypatch.undo()
    assert sequence.open_array("depth/depth").shape[0] == 21
    assert causes(sequence) == []
    sequence.ensure_array(DEPTH, {**SHAPE, "frame": 21})
    assert is_sealed(sequence.root / "depth/depth"), "the next run seals what it finds"


@pytest.mark.parametrize("harm", ["shard gone", "shard of another array", "description"])
def test_cameras_that_are_not_what_was_written_are_named_and_mended(harm: str, sequence: SequenceGroup) -> None:
    folder = sequence.root / "source/intrinsics"
    chunk = folder / "c.0.0.0"
    if harm == "shard gone":
        chunk.unlink()
    elif harm == "description":
        edit(folder / "zarr.json", lambda data: data["attributes"].__setitem__("unit", "m"))
    else:
        sequence.put("other", np.ones_like(sequence.capture.rig.intrinsics), ("view", "row", "column"), "px", "x")
        chunk.write_bytes((sequence.root / "other/c.0.0.0").read_bytes())
    with pytest.raises(ArchiveError, match="verify"):
        sequence.get("source/intrinsics")
    found = list(faults(again(sequence), Count()))
    assert [f.file for f in found] == ["source/intrinsics/zarr.json"]
    repair(again(sequence), found[0])
    np.testing.assert_array_equal(sequence.get("source/intrinsics"), sequence.capture.rig.intrinsics)
    assert causes(sequence) == []


def test_a_receipt_with_a_changed_digit_is_none(sequence: SequenceGroup) -> None:
    receipt = Receipt("survey", None, 0, None, "f" * 32, {}, (), (), {"noted": {"survey/gain": 1.25}, "seconds": 2})
    write_receipt(sequence, receipt)
    file = next(sequence.receipts.rglob("*.json"))
    whole = file.read_bytes()
    assert list(scan_receipts(sequence)) == [receipt]
    for old, new in ((b"1.25", b"1.26"), (b'"view": 0', b'"view": 1'), (b'"warnings"', b'"warnings" ')):
        file.write_bytes(whole.replace(old, new))
        assert list(scan_receipts(sequence)) == [], f"{old!r} -> {new!r}"
        assert [f.cause for f in faults(again(sequence), Count())] == ["its receipt cannot be read"]
    old_one = {k: v for k, v in json.loads(whole).items() if k != checksums.KEY}
    file.write_text(json.dumps(old_one))
    assert list(scan_receipts(sequence)) == [receipt], "one of an earlier version has no checksum"


def test_sealing_changes_nothing_but_the_checksum(sequence: SequenceGroup) -> None:
    before = read_metadata(sequence.root / "depth/depth")
    seal(sequence.root / "depth/depth")
    assert read_metadata(sequence.root / "depth/depth") == before
