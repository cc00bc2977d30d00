"""The ledger: one Parquet table an archive, a row a finished task, rebuilt from the receipts at any time.

The receipts are the truth; the ledger is for questions (what took how long, what failed its checks) and for history.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from storage.archive import Archive, Sequence, write_atomically
from storage.receipts import Receipt, scan_receipts

LEDGER = "ledger.parquet"
"""File name in the archive's folder."""

COLUMNS = ("sequence", "stage", "partition", "view", "path", "fingerprint", "seconds", "bytes", "warnings", "started", "host", "worker", "device", "peak_rss")
"""Columns of the ledger."""


def row(sequence: str, receipt: Receipt) -> dict[str, Any]:
    """One row of the ledger."""
    f = receipt.facts
    return {
        "sequence": sequence,
        "stage": receipt.stage,
        "partition": receipt.partition,
        "view": receipt.view,
        "path": receipt.path,
        "fingerprint": receipt.fingerprint,
        "seconds": f.get("seconds"),
        "bytes": sum(file.size for o in receipt.outputs for file in o.files),
        "warnings": len(receipt.warnings),
        "started": f.get("started"),
        "host": f.get("host"),
        "worker": f.get("worker"),
        "device": f.get("device"),
        "peak_rss": f.get("peak_rss"),
    }


def rebuild(archive: Archive) -> Path:
    """Write the ledger anew from all receipts of all sequences; returns its path."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = [row(name, r) for name in archive.names() for r in scan_receipts(Sequence(archive.root / name))]
    types = {"partition": pa.int64(), "view": pa.int64(), "seconds": pa.float64(), "bytes": pa.int64(), "warnings": pa.int64(), "peak_rss": pa.int64()}
    schema = pa.schema([(c, types.get(c, pa.string())) for c in COLUMNS])
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), sink)
    write_atomically(archive.root / LEDGER, sink.getvalue().to_pybytes())
    return archive.root / LEDGER


def read(archive: Archive) -> list[dict[str, Any]]:
    """All rows; an archive without a ledger has none."""
    import pyarrow.parquet as pq

    file = archive.root / LEDGER
    return pq.read_table(file).to_pylist() if file.is_file() else []
