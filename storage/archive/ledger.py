"""The ledger: one Parquet table an archive, a row a finished task and a row a failure, rebuilt at any time.

Receipts (what is finished) and the runs' logs (what failed) are the truth; the ledger is for questions: what took how
long, which memory, what failed. docs/reference/ledger.md answers the usual ones in one query each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from posegaussian.storage.archive.receipts import MOST_NUMBER, Receipt, scan_receipts
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.files.names import folders_in, is_word, parse_json, read_file
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ArchiveError, LedgerDamaged
from posegaussian.storage.model.spec import digest

LEDGER = "ledger.parquet"
"""File name in the archive's folder."""

RUNS = "_runs"
"""Folder of the runs below the archive's: one folder a run, named by its start in UTC."""

EVENTS = "events.jsonl"
"""File of a run's events, one JSON object a line."""

MOST_LOG_BYTES = 2**32
"""Bytes of a run's log."""

KEY = ("sequence", "stage", "partition", "view", "path")
"""What identifies a task."""

COLUMNS = (
    *KEY,
    "state",
    "fingerprint",
    "seconds",
    "modules",
    "bytes",
    "warnings",
    "started",
    "host",
    "worker",
    "device",
    "peak_rss",
    "projected_ram",
    "raw_bytes",
    "work",
    "unit",
    "params",
    "effects",
    "run",
    "error",
    "mended",
)
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
        "unit": f.get("unit"),
        "params": digest(receipt.parts.get("params", {})),
        "effects": " ".join(sorted(receipt.parts.get("effects", {}))),
        "run": None,
        "error": None,
        "mended": None,
    }


def run_events(archive: Archive) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """(name of the run, its events) of all runs, oldest first; a line that a kill cut off, or that no run writes, is
    left out.

    Raises Unsafe for links.
    """
    for folder in folders_in(archive.place(RUNS)):
        try:
            lines = read_file(folder / EVENTS, MOST_LOG_BYTES).splitlines()
        except FileNotFoundError:
            continue
        events = []
        for line in lines:
            try:
                event = parse_json(line)
            except ValueError:
                continue
            if isinstance(event, dict) and _is_event(event):
                events.append(event)
        yield folder.name, events


def _is_event(event: dict[str, Any]) -> bool:
    """Whether a run can have told an event: one about a task names a task."""
    name = event.get("event")
    if not isinstance(name, str):
        return False
    if name == "task_failed" and not event.keys() >= {"error", "time"}:
        return False
    spoken = [*([event] if name.startswith("task_") else []), *([event["by"]] if "by" in event else [])]
    return all(isinstance(t, dict) and _is_task(t) for t in spoken) and (
        "by" not in event or event["by"].keys() == set(KEY)
    )


def _is_task(task: dict[str, Any]) -> bool:
    if not task.keys() >= set(KEY):
        return False
    whole = all(n is None or (type(n) is int and 0 <= n < MOST_NUMBER) for n in (task["partition"], task["view"]))
    return (
        whole
        and isinstance(task["sequence"], str)
        and is_word(task["stage"])
        and (task["path"] is None or is_word(task["path"]))
    )


def failures(archive: Archive, finished: dict[tuple[Any, ...], str]) -> list[dict[str, Any]]:
    """Rows of everything that ever failed, oldest first; `finished` is {KEY of a task: when its receipt's run of it
    began}.

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
            rows.append(
                {
                    **dict.fromkeys(COLUMNS),
                    **dict(zip(KEY, key, strict=True)),
                    "state": "failed",
                    "started": when,
                    "run": run,
                    "error": e.get("error"),
                    "mended": finished.get(key, "") > when,
                }
            )
    return rows


def _schema() -> Any:
    """Columns of the ledger with their types."""
    import pyarrow as pa

    whole = dict.fromkeys(
        ("partition", "view", "bytes", "warnings", "peak_rss", "projected_ram", "raw_bytes", "work"), pa.int64()
    )
    types = {**whole, "seconds": pa.float64(), "modules": pa.map_(pa.string(), pa.float64()), "mended": pa.bool_()}
    return pa.schema([(c, types.get(c, pa.string())) for c in COLUMNS])


def rebuild(archive: Archive) -> Path:
    """Write the ledger anew from all receipts and all run logs of all sequences that can be read; returns its path."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(_every_row(archive), schema=_schema()), sink)
    file = archive.place(LEDGER)
    write_atomically(file, sink.getvalue().to_pybytes())
    return file


def _every_row(archive: Archive) -> list[dict[str, Any]]:
    """What the ledger has to say."""
    rows = [r for name in archive.names() for r in _rows(archive, name)]
    return rows + failures(archive, {tuple(r[k] for k in KEY): r["started"] or "" for r in rows})


def _rows(archive: Archive, name: str) -> list[dict[str, Any]]:
    try:
        return [row(name, r) for r in scan_receipts(archive.sequence(name))]
    except ArchiveError:
        return []  # every command that touches the sequence says what is wrong with it


def _table(archive: Archive, columns: Sequence[str]) -> Any:
    """Columns of the ledger, those of them that it has; None where there is no ledger. Raises LedgerDamaged for what is
    no ledger, and what `place` does for what is not in the archive."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = archive.place(LEDGER)
    if not file.is_file():
        return None
    try:
        found = pq.ParquetFile(file)
        wrong = [
            f"column {f.name} of type {f.type}"
            for f in found.schema_arrow
            if f.name in COLUMNS and f.type != _schema().field(f.name).type
        ]
        if not wrong:
            table = found.read(columns=[c for c in columns if c in found.schema_arrow.names])
            table.validate(full=True)
            return table
    except (pa.ArrowException, OSError) as e:
        wrong = [str(e)]
    raise LedgerDamaged(
        f"{file} is damaged or no ledger ({wrong[0][:200]}); what it would say is taken from the receipts and the runs'"
        " logs, and the next run writes it anew"
    )


def faults(archive: Archive) -> list[str]:
    """A sentence about a ledger that cannot be read."""
    try:
        _table(archive, COLUMNS)
    except LedgerDamaged as e:
        return [str(e)]
    return []


def failed(archive: Archive) -> list[tuple[Any, ...]]:
    """KEY of every task that failed and was not finished since, by the end of the last run."""
    rows = read(archive, (*KEY, "state", "mended"))
    return list(
        dict.fromkeys(tuple(r[k] for k in KEY) for r in rows if r["state"] == "failed" and r["mended"] is False)
    )


def read(archive: Archive, columns: Sequence[str] = COLUMNS) -> list[dict[str, Any]]:
    """All rows, of some columns; an archive without a ledger has none, a ledger of an older version is null where it
    lacks a column. Where it is damaged, as `faults` says, the rows are those of a new one."""
    try:
        found = _table(archive, columns)
    except LedgerDamaged:
        return [{c: row[c] for c in columns} for row in _every_row(archive)]
    rows = [] if found is None else found.to_pylist(maps_as_pydicts="strict")
    return [{c: row.get(c) for c in columns} for row in rows]
