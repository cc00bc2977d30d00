"""A power cut at any moment leaves true receipts:
what a receipt promises was synced to the disk before the receipt was."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from posegaussian.storage.archive.receipts import receipt_file, scan_receipts
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="which file a descriptor means is only told by /proc")
def test_every_shard_and_its_folder_is_synced_before_its_receipt(
    person_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder, ["frames.range=0:2", "depth.method=hull"])
    pipeline.register()
    synced: list[str] = []
    fsync, replace = os.fsync, os.replace

    def note_sync(handle: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)

    def note_replace(source: str | Path, target: str | Path) -> None:
        synced.append(f"{source} becomes {target}")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(os, "replace", note_replace)
    pipeline.run()
    sequence = Archive.open(str(pipeline.root)).sequence(NAME)
    receipts = list(scan_receipts(sequence))
    assert len(receipts) > 10
    for r in receipts:
        named = str(receipt_file(sequence, r.stage, r.partition, r.view, r.path))
        (at,) = [i for i, line in enumerate(synced) if line.endswith(f" becomes {named}")]
        source = synced[at].partition(" becomes ")[0]
        assert source in synced[:at], f"the text of {named} was not synced before it got its name"
        assert str(Path(named).parent) in synced[at:], f"the name of {named} was not synced"
        for f in (f for o in r.outputs for f in o.files):
            file = sequence.root / f.key
            assert str(file) in synced[:at], f"{f.key} was not synced before its receipt"
            shard = max(i for i, line in enumerate(synced[:at]) if line == str(file))
            assert str(file.parent) in synced[shard:at], f"the folder of {f.key} was not synced before the receipt"
