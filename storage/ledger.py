"""The ledger: one Parquet table an archive, a row a finished task and a row a failure, rebuilt at any time.

Receipts (what is finished) and the runs' logs (what failed) are the truth; the ledger is for questions: what took how
long, which memory, what failed. docs/ledger.md answers the usual ones in one query each.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from storage.archive import Archive
from storage.archive import Sequence as Group
from storage.files import write_atomically
from storage.receipts import Receipt, scan_receipts
from storage.spec import digest

LEDGER = "ledger.parquet"
"""File name in the archive's folder."""

RUNS = "_runs"
"""Folder of the runs below the archive's: one folder a run, named by its start in UTC."""

EVENTS = "events.jsonl"
"""File of a run's events, one JSON object a line."""

KEY = ("sequence", "stage", "partition", "view", "path")
"""What identifies a task."""

COLUMNS = (*KEY, "state", "fingerprint", "seconds", "modules", "bytes", "warnings", "started", "host", "worker", "device", "peak_rss", "projected_ram", "raw_bytes", "work", "params", "effects", "run", "error", "mended")
"""Columns of the ledger."""


def row(sequence: str, receipt: Receipt) -> dict[str, Any]:
    """The row of a finished task."""
    f = receipt.facts
    return {
        "sequence": sequence,
        "stage": receipt.stage,
        "partition": receipt.partition,
        "view": receipt.view,
        "path": receipt.path,
        "state": "done",
        "fingerprint": receipt.fingerprint,
        "seconds": f.get("seconds"),
        "modules": f.get("modules"),
        "bytes": sum(file.size for o in receipt.outputs for file in o.files),
        "warnings": len(receipt.warnings),
        "started": f.get("started"),
        "host": f.get("host"),
        "worker": f.get("worker"),
        "device": f.get("device"),
        "peak_rss": f.get("peak_rss"),
        "projected_ram": f.get("projected_ram"),
        "raw_bytes": f.get("raw_bytes"),
        "work": f.get("work"),
        "params": digest(receipt.parts.get("params", {})),
        "effects": " ".join(sorted(receipt.parts.get("effects", {}))),
        "run": None,
        "error": None,
        "mended": None,
    }


def run_events(archive: Archive) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """(name of the run, its events) of all runs, oldest first; a line that a kill cut off is left out."""
    for file in sorted((archive.root / RUNS).glob(f"*/{EVENTS}")):
        events = []
        for line in file.read_bytes().splitlines():
            try:
                event = json.loads(line)
            except ValueError:
                continue
            if isinstance(event, dict):
                events.append(event)
        yield file.parent.name, events


def failures(archive: Archive, finished: dict[tuple[Any, ...], str]) -> list[dict[str, Any]]:
    """Rows of everything that ever failed, oldest first; `finished` is {KEY of a task: when its receipt's run of it began}.

    `seconds` is null, so that sums and means of times are those of finished tasks; `mended` says whether the task was
    finished since.
    """
    rows = []
    for run, events in run_events(archive):
        for e in events:
            if e.get("event") != "task_failed":
                continue
            key = tuple(e.get(k) for k in KEY)
            when = str(e.get("time"))
            rows.append({**dict.fromkeys(COLUMNS), **dict(zip(KEY, key, strict=True)), "state": "failed", "started": when, "run": run, "error": e.get("error"), "mended": finished.get(key, "") > when})
    return rows


def rebuild(archive: Archive) -> Path:
    """Write the ledger anew from all receipts and all run logs of all sequences; returns its path."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = [row(name, r) for name in archive.names() for r in scan_receipts(Group(archive.root / name))]
    rows += failures(archive, {tuple(r[k] for k in KEY): r["started"] or "" for r in rows})
    types = {"partition": pa.int64(), "view": pa.int64(), "seconds": pa.float64(), "modules": pa.map_(pa.string(), pa.float64()), "bytes": pa.int64(), "warnings": pa.int64(), "peak_rss": pa.int64(), "projected_ram": pa.int64(), "raw_bytes": pa.int64(), "work": pa.int64(), "mended": pa.bool_()}
    schema = pa.schema([(c, types.get(c, pa.string())) for c in COLUMNS])
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), sink)
    write_atomically(archive.root / LEDGER, sink.getvalue().to_pybytes())
    return archive.root / LEDGER


def failed(archive: Archive) -> list[tuple[Any, ...]]:
    """KEY of every task that failed and was not finished since, by the end of the last run."""
    import pyarrow.parquet as pq

    file = archive.root / LEDGER
    if not file.is_file():
        return []
    rows = pq.read_table(file, columns=[*KEY], filters=[("state", "=", "failed"), ("mended", "=", False)]).to_pylist()
    return list(dict.fromkeys(tuple(r[k] for k in KEY) for r in rows))


def read(archive: Archive, columns: Sequence[str] = COLUMNS) -> list[dict[str, Any]]:
    """All rows, of some columns; an archive without a ledger has none, a ledger of an older version is null where it lacks a column."""
    import pyarrow.parquet as pq

    file = archive.root / LEDGER
    if not file.is_file():
        return []
    there = set(pq.read_schema(file).names)
    rows = pq.read_table(file, columns=[c for c in columns if c in there]).to_pylist(maps_as_pydicts="strict")
    return [{c: row.get(c) for c in columns} for row in rows]
