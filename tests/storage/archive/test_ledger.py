"""The ledger says what the receipts say, and can be made anew from them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.receipts import Output, Receipt, ShardFile, write_receipt
from posegaussian.storage.archive.store import Archive
from tests.support.sample_captures import make_capture

FACTS = {
    "seconds": 2.5,
    "started": "2026-01-01T00:00:00.000+00:00",
    "host": "h",
    "worker": "w1",
    "device": "cpu",
    "peak_rss": 2**30,
}


def receipt(
    stage: str, partition: int | None, view: int | None = None, path: str | None = None, **facts: object
) -> Receipt:
    x, y = f"{stage}/x", f"{stage}/y"
    outputs = (
        Output(x, view, "d", (ShardFile(f"{x}/c/0", 100, 1), ShardFile(f"{x}/c/1", 23, 2))),
        Output(y, view, "d", (ShardFile(f"{y}/c/0", 100, 1),)),
    )
    return Receipt(stage, partition, view, path, "f" * 32, {}, outputs, ("odd",), {**FACTS, **facts})


def make_archive(folder: Path) -> tuple[Archive, dict[str, list[Receipt]]]:
    archive = Archive.open(str(folder), create=True)
    made = {
        "kick": [
            receipt("depth", 0),
            receipt("depth", 1),
            receipt("network", 0, modules={"heads": 0.5, "refinement": 1.5}),
            receipt("network", 1, modules={"refinement": 1.0}),
            receipt("frames", 0, view=2),
            receipt("rendering", 0, path="orbit-1"),
            receipt("survey", None, view=0, seconds=None),
        ],
        "walk": [receipt("depth", 0)],
        "idle": [],
    }
    for name, of_sequence in made.items():
        sequence = archive.create_sequence(name, make_capture(), 4)
        for r in of_sequence:
            write_receipt(sequence, r)
    return archive, made


def log(archive: Archive, run: str, *events: dict) -> None:
    """Events of a run as its log holds them."""
    folder = archive.root / ledger.RUNS / run
    folder.mkdir(parents=True)
    (folder / ledger.EVENTS).write_text("".join(json.dumps(e) + "\n" for e in events) + '{"time": "2026-01-01T00:00:0')


def failed(stage: str, partition: int, time: str, error: str = "no disk") -> dict:
    return {
        "time": time,
        "event": "task_failed",
        "sequence": "kick",
        "stage": stage,
        "partition": partition,
        "view": None,
        "path": None,
        "error": error,
        "details": "",
        "kind": "transient",
    }


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


@pytest.mark.parametrize(
    "harm",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: bytes(len(data)),
        lambda data: data[:4] + bytes(len(data) // 2) + data[4 + len(data) // 2 :],
        lambda data: b"null",
    ],
    ids=["emptied", "cut", "zeros", "zeros inside", "no Parquet"],
)
def test_a_damaged_ledger_is_told_and_answers_as_a_new_one(tmp_path: Path, harm: Callable[[bytes], bytes]) -> None:
    archive, _ = make_archive(tmp_path)
    log(archive, "a", failed("depth", 7, "2026-01-02T00:00:00.000+00:00"))
    file = ledger.rebuild(archive)
    rows, lost, whole = ledger.read(archive), ledger.failed(archive), file.read_bytes()
    assert ledger.faults(archive) == []
    file.write_bytes(harm(whole))
    (told,) = ledger.faults(archive)
    assert f"{file} is damaged or no ledger (" in told
    assert "the next run writes it anew" in told
    assert ledger.read(archive) == rows
    assert ledger.failed(archive) == lost != []
    assert ledger.rebuild(archive).read_bytes() == whole
    assert ledger.faults(archive) == []


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


def test_failures_stay_in_the_ledger_and_say_whether_they_were_mended(tmp_path: Path) -> None:
    archive, made = make_archive(tmp_path)
    log(
        archive,
        "20251231T220000Z",
        {"time": "2025-12-31T22:00:00.000+00:00", "event": "run_started"},
        failed("depth", 0, "2025-12-31T23:00:00.000+00:00"),
        failed("gaussians", 0, "2025-12-31T23:00:01.000+00:00"),
    )
    log(archive, "20260101T010000Z", failed("depth", 1, "2026-01-01T01:00:00.000+00:00", "again"))
    ledger.rebuild(archive)
    rows = ledger.read(archive)
    assert len([r for r in rows if r["state"] == "done"]) == sum(map(len, made.values()))
    found = [(r["run"], r["stage"], r["partition"], r["error"], r["mended"]) for r in rows if r["state"] == "failed"]
    assert found == [
        ("20251231T220000Z", "depth", 0, "no disk", True),
        ("20251231T220000Z", "gaussians", 0, "no disk", False),
        ("20260101T010000Z", "depth", 1, "again", False),
    ]
    assert all(r["seconds"] is None and r["peak_rss"] is None for r in rows if r["state"] == "failed"), (
        "means and sums are those of finished tasks"
    )


def test_a_ledger_without_a_column_of_today_is_null_there(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    archive, _ = make_archive(tmp_path)
    file = ledger.rebuild(archive)
    now = ledger.read(archive)
    assert [r["modules"] for r in now if r["stage"] == "network"] == [
        {"heads": 0.5, "refinement": 1.5},
        {"refinement": 1.0},
    ]
    pq.write_table(pq.read_table(file).drop_columns("modules"), file)  # as it was written before modules were measured
    assert ledger.read(archive) == [{**r, "modules": None} for r in now]
    ledger.rebuild(archive)
    assert ledger.read(archive) == now


DOCS = Path(__file__).resolve().parents[3] / "docs/reference/ledger.md"


def answer(code: str, capsys: pytest.CaptureFixture[str]) -> list[dict]:
    exec(compile(code, str(DOCS), "exec"), {})
    return eval(capsys.readouterr().out, {})


def test_every_documented_query_answers_its_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    archive, _ = make_archive(tmp_path / "archive")
    now = datetime.now(UTC)
    log(archive, "a", failed("depth", 7, (now - timedelta(hours=30)).isoformat(timespec="milliseconds")))
    log(
        archive,
        "b",
        failed("depth", 8, (now - timedelta(hours=6)).isoformat(timespec="milliseconds"), "the disk is full"),
    )
    ledger.rebuild(archive)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.DOTALL)
    assert len(blocks) == 5
    seconds, slowest, modules, memory, failures = (answer(b, capsys) for b in blocks)
    assert seconds[0] == {"stage": "depth", "sequence": "kick", "seconds_sum": 5.0, "seconds_count": 2}
    assert modules == [("refinement", 2.5), ("heads", 0.5)]
    assert [r["seconds"] for r in slowest[:4]] == [2.5] * 4
    assert {(r["stage"], r["peak_rss_max"]) for r in memory} == {
        (s, 2**30) for s in ("depth", "frames", "network", "rendering", "survey")
    }
    assert [(r["partition"], r["error"], r["mended"]) for r in failures] == [(8, "the disk is full", False)]


def test_the_docs_name_every_column() -> None:
    table = DOCS.read_text().partition("| column |")[2].partition("\n\n")[0]
    assert (
        tuple(
            re.findall(
                r"`(\w+)`", "\n".join(line.split("|")[1] for line in table.splitlines() if line.startswith("| `"))
            )
        )
        == ledger.COLUMNS
    )
