"""`verify`: whatever happens to a file behind a receipt's back is found, named, and made anew after a repair."""

from __future__ import annotations

import io
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from posegaussian.dags.maintenance.verify import verify
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.run_registry import folder
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive import integrity, ledger
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import ReceiptKey, lease_file
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld, ShardCorrupt
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content

SHARD = "depth/depth/c.1.2.0.0"
"""Partition 1 of view cam02."""


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def say(pipeline: Pipeline, repair: bool = False) -> tuple[int, str]:
    console = Console(file=io.StringIO(), width=400)
    status = verify(Session(pipeline.configuration, str(pipeline.root), console), [NAME], repair).status
    return status, console.file.getvalue()  # type: ignore[attr-defined]


def flip(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


HARMS = {
    "missing": (lambda f: f.unlink(), "missing"),
    "emptied": (lambda f: f.write_bytes(b""), "emptied"),
    "truncated": (lambda f: f.write_bytes(f.read_bytes()[:-7]), "truncated to "),
    "bit flipped": (flip, "bits changed"),
}


def test_an_undisturbed_archive_has_no_fault(archive: Pipeline) -> None:
    status, said = say(archive)
    assert status == 0, said
    assert "no faults" in said


def test_a_damaged_ledger_is_named_and_a_repair_writes_it_anew(archive: Pipeline) -> None:
    file = ledger.rebuild(archive.session.archive)
    whole = file.read_bytes()
    file.write_bytes(whole[:-9])
    assert archive.session.history.timed, "who plans goes on with what the receipts say"
    status, said = say(archive)
    assert status == 1
    assert f"{file} is damaged or no ledger" in said
    assert "--repair writes it anew at once" in said
    assert file.read_bytes() == whole[:-9]
    status, said = say(archive, repair=True)
    assert status == 1
    assert "; written anew" in said
    assert file.read_bytes() == whole
    assert say(archive)[0] == 0


def test_harmed_shards_are_named_and_after_a_repair_only_their_tasks_are_made_anew(
    archive: Pipeline, finished: Pipeline
) -> None:
    shards = [
        "depth/depth/c.1.2.0.0",
        "gaussians/scale/c.2.3.0.0.0",
        "smoothing/heatmaps/c.0.1.0.0.0",
        "frames/color/c.1.4.0.0.0",
    ]
    for shard, (do, _) in zip(shards, HARMS.values(), strict=True):
        do(archive.root / NAME / shard)
    status, said = say(archive)
    assert status == 1
    names = archive.context().views.names
    for shard, (_, cause) in zip(shards, HARMS.values(), strict=True):
        array, _, place = shard.partition("/c.")
        partition, view = place.split(".")[:2]
        assert f"{array}, partition {partition}, view {names[int(view)]}: {shard}: {cause}" in said
    assert said.count("--repair would remove the receipt of") == 4
    assert "receipt of depth p0001, so that the next run makes it anew" in said
    seen = {
        v.task.stage
        for v in archive.plan().verdicts.values()
        if any("is missing or of another size" in r for r in v.reasons)
    }
    assert seen == {
        "depth",
        "gaussians",
        "smoothing",
    }, "a plan compares names and sizes; the flipped bit only verify finds"
    assert say(archive, repair=True)[0] == 1
    assert archive.ran() == {"frames": 1, "smoothing": 1, "depth": 1, "gaussians": 1}
    assert say(archive)[0] == 0
    assert_same_content(content(archive), content(finished))


def test_a_flipped_bit_is_never_read_as_data(archive: Pipeline) -> None:
    """Wherever the bit lies that was flipped: in the data, in a chunk's checksum, in the index of the shard."""
    from posegaussian.dags.planning.results import Results

    file = archive.root / NAME / SHARD
    whole = file.read_bytes()
    for place in range(0, len(whole), max(1, len(whole) // 16)):
        data = bytearray(whole)
        data[place] ^= 0x10
        file.write_bytes(data)
        with pytest.raises(ShardCorrupt, match="verify --sequence person --repair"):
            Results(archive.context()).read("depth/depth", range(2, 4), 2)


def test_a_table_a_receipt_and_a_left_over_are_verified_too(archive: Pipeline, finished: Pipeline) -> None:
    root = archive.root / NAME
    table = next(root.rglob("metrics/**/p000001.parquet"))
    flip(table)
    receipt = root / "_receipts/gaussians/p000002.json"
    receipt.write_bytes(receipt.read_bytes()[:99])
    left = root / "depth/depth/c.0.0.0.0123abcd.partial"
    left.write_bytes(b"half a shard")
    status, said = say(archive)
    assert status == 1
    assert f"partition 1: {table.relative_to(root)}: bits changed" in said
    assert "_receipts/gaussians/p000002.json: its receipt cannot be read" in said
    assert f"{left.relative_to(root)}: left over by a killed writer; harmless" in said
    say(archive, repair=True)
    assert not left.exists()
    assert archive.ran() == {"gaussians": 1, "metrics": 1}
    assert say(archive)[0] == 0
    assert_same_content(content(archive), content(finished))


def test_a_broken_array_record_is_written_anew(archive: Pipeline, finished: Pipeline) -> None:
    (archive.root / NAME / "smoothing/heatmaps/zarr.json").write_text("{")
    status, said = say(archive, repair=True)
    assert status == 1
    assert "smoothing/heatmaps: does not decode" in said
    assert archive.ran() == {"smoothing": 3}
    assert_same_content(content(archive), content(finished))


def test_content_that_is_whole_but_not_what_was_promised_is_found(archive: Pipeline) -> None:
    receipt = archive.root / NAME / "_receipts/depth/p000000.json"
    data = json.loads(receipt.read_bytes())
    data["outputs"][0]["digest"] = "0" * 32
    del data["checksum"]
    receipt.write_text(json.dumps(data))
    assert "its content is not the promised one" in say(archive)[1]


def test_damaged_cameras_are_named_and_the_next_run_writes_them_again(archive: Pipeline) -> None:
    for name in ("frames/intrinsics", "source/distortion", "frames/time"):
        file = archive.root / NAME / name / "zarr.json"
        file.write_text(file.read_text().replace('"float64"', '"float32"'))
    status, said = say(archive, repair=True)
    assert status == 1
    assert said.count("does not describe an array as this program writes it (it changed since it was written") == 3
    assert archive.plan().all_fresh, "they are for other readers of Zarr; nothing is computed from them"
    assert archive.session.run_and_report([archive.plan()], Selection()) == 0
    assert say(archive)[0] == 0


def test_a_changed_digit_in_the_record_is_named_and_nothing_is_planned_from_it(archive: Pipeline) -> None:
    file = archive.root / NAME / "zarr.json"
    whole = file.read_bytes()
    assert b"50.400000000000006" in whole
    file.write_bytes(whole.replace(b"50.400000000000006", b"50.410000000000006", 1))
    status, said = say(archive, repair=True)
    assert status == 1
    assert f"{file} changed since it was written" in said
    with pytest.raises(ArchiveError, match="put the old file back, or import the capture again"):
        archive.plan()
    archive.register()
    assert archive.plan().all_fresh, "what was computed is as it was"
    assert say(archive)[0] == 0


def test_an_archive_of_before_is_fresh_and_gets_its_checksums_by_a_repair(archive: Pipeline) -> None:
    for file in (archive.root / NAME).rglob("zarr.json"):
        data = json.loads(file.read_bytes())
        for kept in (data["attributes"], data["attributes"].get("posegaussian", {})):
            kept.pop("checksum", None)
            kept.pop("digest", None)
        file.write_text(json.dumps(data))
    for file in (archive.root / NAME / "_receipts").rglob("*.json"):
        file.write_text(json.dumps({k: v for k, v in json.loads(file.read_bytes()).items() if k != "checksum"}))
    assert archive.plan().all_fresh
    status, said = say(archive)
    assert status == 0
    assert "of an earlier version without a checksum" in said
    status, said = say(archive, repair=True)
    assert status == 0
    assert "checksums added" in said
    assert "checksum" not in say(archive)[1]
    assert archive.plan().all_fresh


def test_a_source_file_that_changed_but_kept_size_and_time_is_named_and_left_alone(
    finished: Pipeline, tmp_path: Path
) -> None:
    archive = finished.copy(tmp_path / "archive")
    archive = replace(archive, folder=Path(shutil.copytree(archive.folder, tmp_path / "capture")))
    archive.register()
    picture = archive.folder / "images/cam01/000000.png"
    whole, time = picture.read_bytes(), picture.stat().st_mtime_ns
    assert say(archive)[0] == 0
    flip(picture)
    os.utime(picture, ns=(time, time))
    assert archive.plan().all_fresh, "a plan trusts size and time"
    changed = picture.read_bytes()
    session, before = archive.session, content(archive)
    for repair in (False, True):
        status, said = say(archive, repair)
        assert status == 1
        assert (
            f"{picture}: source file that is not what was imported (it has the same size and another content)" in said
        )
        assert "import the capture again, and what was made of the file is made anew; or put the old one back" in said
        assert "`posegaussian run --from survey`" in said
        assert "next run makes it anew" not in said
        assert verify(session, [NAME], repair).following == ("verify",), "a run would read the file as it is"
    assert (picture.read_bytes(), archive.plan().all_fresh) == (changed, True)
    assert_same_content(content(archive), before)
    picture.write_bytes(whole)
    status, said = say(archive)
    assert (status, "no faults" in said) == (0, True), "another time alone is no fault"
    picture.unlink()
    status, said = say(archive)
    assert status == 0
    assert f"1 source file left out, gone since the import, for example {picture}" in said


def test_what_can_be_mended_is_mended_beside_a_source_file_that_cannot(finished: Pipeline, tmp_path: Path) -> None:
    archive = finished.copy(tmp_path / "archive")
    archive = replace(archive, folder=Path(shutil.copytree(archive.folder, tmp_path / "capture")))
    archive.register()
    (archive.folder / "images/cam01/000000.png").write_bytes(b"no picture")
    (archive.root / NAME / SHARD).unlink()
    session = archive.session
    assert verify(session, [NAME], mend=False) == (1, ("verify", "--repair"))
    status, said = say(archive, repair=True)
    assert (status, "the receipt of depth p0001 is removed" in said) == (1, True)
    assert verify(session, [NAME], mend=False) == (1, ("verify",))


def test_what_a_run_works_on_is_left_out(archive: Pipeline) -> None:
    sequence = archive.context().sequence
    (archive.root / NAME / SHARD).unlink()
    with Lease.take(lease_file(sequence, ReceiptKey("depth", 1, None, None)), "a-run"):
        status, said = say(archive, repair=True)
        assert status == 0, said
        assert "1 task left out, because a run works there now" in said
    assert (archive.root / NAME / "_receipts/depth/p000001.json").exists()


def test_a_run_that_works_on_no_task_leaves_nothing_out(archive: Pipeline) -> None:
    """It says that it is there, and makes arrays."""
    sequence = archive.context().sequence
    with (
        Lease.take(folder(sequence) / "a-run.lease", "a-run"),
        Lease.take(sequence.receipts / "_arrays.lease", "a-run"),
    ):
        status, said = say(archive)
    assert (status, "left out" in said) == (0, False), said


def test_of_two_repairs_at_once_the_second_leaves_the_task_to_the_first(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, real = archive.context().sequence, integrity.remove_receipt
    (archive.root / NAME / SHARD).unlink()
    (fault,) = integrity.faults(sequence, integrity.Count())

    def meanwhile(*args: Any) -> None:
        with pytest.raises(LeaseHeld, match="is held by run verify-"):
            integrity.repair(sequence, fault)
        real(*args)

    monkeypatch.setattr(integrity, "remove_receipt", meanwhile)
    integrity.repair(sequence, fault)
    assert not (archive.root / NAME / "_receipts/depth/p000001.json").exists()
