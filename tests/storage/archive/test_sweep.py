"""Deleting in an order that a death at any moment makes harmless."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from posegaussian.storage.archive import deletion
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import (
    Output,
    Receipt,
    ReceiptKey,
    ShardFile,
    lease_file,
    missing_files,
    read_receipt,
    remove_receipt,
    write_receipt,
)
from posegaussian.storage.archive.store import SequenceGroup


@pytest.fixture
def sequence(tmp_path: Path) -> SequenceGroup:
    """Two arrays of one task, two partitions; files stand for shards, those of the one in folders as earlier
    versions made them."""
    s = SequenceGroup(tmp_path / "s")
    for partition in (0, 1):
        write_receipt(s, made(s, partition))
    for array in ("a/one", "a/two"):
        (s.root / array / "zarr.json").write_text("{}")
    return s


def made(s: SequenceGroup, partition: int, fingerprint: str = "f") -> Receipt:
    outputs = []
    for array in ("a/one", "a/two"):
        key = f"{array}/{'c/%d/0/0' if array == 'a/one' else 'c.%d.0.0'}" % partition
        (s.root / key).parent.mkdir(parents=True, exist_ok=True)
        (s.root / key).write_bytes(b"x" * 10)
        outputs.append(Output(array, 0, "d" + array, (ShardFile(key, 10, 0),)))
    return Receipt("a", partition, None, None, fingerprint, {}, tuple(outputs))


def on_disk(s: SequenceGroup, partition: int) -> Receipt | None:
    return read_receipt(s, ReceiptKey("a", partition, None, None))


def test_dropping_marks_the_receipt_keeps_the_digest_and_frees_the_files(sequence: SequenceGroup) -> None:
    receipt = on_disk(sequence, 0)
    assert receipt is not None
    after = deletion.drop_outputs(sequence, receipt, {("a/one", 0)})
    assert after == on_disk(sequence, 0)
    assert after.contents == receipt.contents
    assert after.present == {("a/two", 0): "da/two"}
    assert missing_files(sequence, after) == []
    assert not (sequence.root / "a/one/c/0/0").exists()
    assert (sequence.root / "a/one/c/0").is_dir(), "other tasks may write into the partition's folder"
    assert (sequence.root / "a/one/c/1/0/0").exists()
    assert deletion.drop_outputs(sequence, receipt, {("a/one", 0)}) == after, "dropping again changes nothing"


def test_the_receipt_says_dropped_before_the_first_file_goes(
    sequence: SequenceGroup, monkeypatch: pytest.MonkeyPatch
) -> None:
    receipt = on_disk(sequence, 0)
    assert receipt is not None
    monkeypatch.setattr(deletion, "_partition_folder", lambda *a: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        deletion.drop_outputs(sequence, receipt, {("a/one", 0), ("a/two", 0)})
    now = on_disk(sequence, 0)
    assert now is not None
    assert all(o.dropped for o in now.outputs)
    assert (sequence.root / "a/two/c.0.0.0").exists(), "a file is left over, and no promise is broken"


@pytest.mark.parametrize("change", ["another fingerprint", "gone"])
def test_what_another_run_made_meanwhile_is_left_alone(change: str, sequence: SequenceGroup) -> None:
    receipt = on_disk(sequence, 0)
    assert receipt is not None
    if change == "gone":
        remove_receipt(sequence, "a", 0, None, None)
    else:
        write_receipt(sequence, made(sequence, 0, "g"))
    assert deletion.drop_outputs(sequence, receipt, {("a/one", 0)}) == receipt
    assert (sequence.root / "a/one/c/0/0/0").exists()


def test_what_another_run_is_making_is_left_alone(sequence: SequenceGroup) -> None:
    receipt = on_disk(sequence, 0)
    assert receipt is not None
    with Lease.take(lease_file(sequence, ReceiptKey("a", 0, None, None)), "someone else"):
        assert deletion.drop_outputs(sequence, receipt, {("a/one", 0)}) == receipt
    assert (sequence.root / "a/one/c/0/0/0").exists()


def test_what_another_sweep_drops_is_left_to_it(sequence: SequenceGroup, monkeypatch: pytest.MonkeyPatch) -> None:
    receipt, seen = on_disk(sequence, 0), []
    assert receipt is not None

    def meanwhile(*args: Any) -> None:
        seen.append(deletion.drop_outputs(sequence, receipt, {("a/two", 0)}))
        write_receipt(*args)

    monkeypatch.setattr(deletion, "write_receipt", meanwhile)
    deletion.drop_outputs(sequence, receipt, {("a/one", 0)})
    assert seen == [receipt]
    assert (sequence.root / "a/two/c.0.0.0").exists()


def test_forgetting_takes_receipt_and_files_and_leaves_the_arrays(sequence: SequenceGroup) -> None:
    receipt = on_disk(sequence, 1)
    assert receipt is not None
    deletion.forget(sequence, receipt)
    assert on_disk(sequence, 1) is None
    assert not (sequence.root / "a/one/c/1").exists()
    assert (sequence.root / "a/one/zarr.json").exists()
    assert (sequence.root / "a/one/c/0/0/0").exists()
    assert on_disk(sequence, 0) is not None


def test_a_folder_is_renamed_before_it_is_emptied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "x"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "f").write_text("1")
    assert deletion.folder_bytes(folder) == 1
    monkeypatch.setattr(deletion.shutil, "rmtree", lambda p: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        deletion.delete_folder(folder)
    assert not folder.exists(), "a half deleted folder must not pass for a whole one"
    monkeypatch.undo()
    (left,) = tmp_path.glob(".x.*.partial")
    assert deletion.partial_files(tmp_path) == [], "young: it may belong to someone at work"
    then = time.time() - 2 * deletion.SETTLED_SECONDS
    os.utime(left, (then, then))
    assert deletion.partial_files(tmp_path) == [left]


def test_strays_are_old_files_that_no_receipt_names(sequence: SequenceGroup) -> None:
    receipts = [r for r in (on_disk(sequence, 0), on_disk(sequence, 1)) if r is not None]
    then = time.time() - 2 * deletion.SETTLED_SECONDS
    for file in (sequence.root / "a").rglob("*"):
        os.utime(file, (then, then))
    assert list(deletion.strays(sequence, receipts, ["a/one", "a/two"])) == []
    assert [
        p.relative_to(sequence.root).as_posix() for p in deletion.strays(sequence, receipts[:1], ["a/one", "a/two"])
    ] == ["a/one/c/1/0/0", "a/two/c.1.0.0"]
    assert list(deletion.strays(sequence, receipts[:1], ["a/three"])) == []
