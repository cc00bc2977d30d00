"""The ledger says what the receipts say, and can be made anew from them."""

from __future__ import annotations

from pathlib import Path

from storage import ledger
from storage.archive import Archive
from storage.receipts import Output, Receipt, ShardFile, write_receipt
from tests.storage.samples import make_capture

FACTS = {"seconds": 2.5, "started": "2026-01-01T00:00:00.000+00:00", "host": "h", "worker": "w1", "device": "cpu", "peak_rss": 2**30}


def receipt(stage: str, partition: int | None, view: int | None = None, path: str | None = None, **facts: object) -> Receipt:
    files = (ShardFile("a", 100, 1), ShardFile("b", 23, 2))
    return Receipt(stage, partition, view, path, "f" * 32, {}, (Output(f"{stage}/x", view, "d", files), Output(f"{stage}/y", view, "d", files[:1])), ("odd",), {**FACTS, **facts})


def make_archive(folder: Path) -> tuple[Archive, dict[str, list[Receipt]]]:
    archive = Archive.open(str(folder), create=True)
    made = {
        "kick": [receipt("depth", 0), receipt("depth", 1), receipt("frames", 0, view=2), receipt("rendering", 0, path="orbit-1"), receipt("survey", None, view=0, seconds=None)],
        "walk": [receipt("depth", 0)],
        "idle": [],
    }
    for name, of_sequence in made.items():
        sequence = archive.create_sequence(name, make_capture(), 4)
        for r in of_sequence:
            write_receipt(sequence, r)
    return archive, made


def by_task(rows: list[dict]) -> list[dict]:
    return sorted(rows, key=lambda r: str([r[c] for c in ledger.COLUMNS]))


def test_a_rebuilt_ledger_equals_the_receipts(tmp_path: Path) -> None:
    archive, made = make_archive(tmp_path)
    file = ledger.rebuild(archive)
    rows = ledger.read(archive)
    assert by_task(rows) == by_task([ledger.row(name, r) for name, rs in made.items() for r in rs])
    assert {(r["bytes"], r["warnings"]) for r in rows} == {(223, 1)}
    before = file.read_bytes()
    file.unlink()
    assert ledger.rebuild(archive).read_bytes() == before


def test_rows_have_the_declared_columns_and_the_facts(tmp_path: Path) -> None:
    archive, _ = make_archive(tmp_path)
    ledger.rebuild(archive)
    (row,) = [r for r in ledger.read(archive) if (r["sequence"], r["stage"], r["view"]) == ("kick", "frames", 2)]
    assert tuple(row) == ledger.COLUMNS
    assert {k: row[k] for k in FACTS} == FACTS
    assert (row["partition"], row["path"]) == (0, None)


def test_an_archive_without_runs_has_an_empty_ledger(tmp_path: Path) -> None:
    archive = Archive.open(str(tmp_path), create=True)
    assert ledger.read(archive) == []
    ledger.rebuild(archive)
    assert ledger.read(archive) == []


def test_one_sequence_of_a_newer_format_does_not_keep_the_others_out(tmp_path: Path) -> None:
    archive, made = make_archive(tmp_path)
    file = tmp_path / "idle" / "zarr.json"
    file.write_text(file.read_text().replace('"format": 1', '"format": 2'))
    assert '"format": 2' in file.read_text()
    ledger.rebuild(archive)
    assert len(ledger.read(archive)) == sum(map(len, made.values()))
