"""Print a table and keep it, with the machine it was measured on."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).with_name("results")


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the rows as a table."""
    columns = list(rows[0])
    cells = [[_text(row[c]) for c in columns] for row in rows]
    widths = [max(len(c), *(len(line[i]) for line in cells)) for i, c in enumerate(columns)]
    for line in [columns, *cells]:
        print("  ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)).rstrip())


def publish(
    name: str | None, rows: Sequence[Mapping[str, Any]], settings: Mapping[str, Any], shown: bool = True
) -> None:
    """Print the rows as a table, if it is to be shown, and write benchmarks/results/<name>.json, where there is a
    name."""
    if shown:
        show(rows)
    if name is None:
        return
    RESULTS.mkdir(exist_ok=True)
    machine = {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    (RESULTS / f"{name}.json").write_text(
        json.dumps({"settings": dict(settings), "machine": machine, "rows": [dict(r) for r in rows]}, indent=1) + "\n"
    )


def kept(name: str) -> list[dict[str, Any]]:
    """The rows kept in benchmarks/results/<name>.json, none where there is no such file."""
    file = RESULTS / f"{name}.json"
    return list(json.loads(file.read_text())["rows"]) if file.exists() else []


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
