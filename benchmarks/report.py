"""Print a table and keep it, with the code, the day and the machine it was measured on."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import tomllib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
RESULTS = Path(__file__).with_name("results")
DIGITS = 4
"""Significant digits of a number that is kept: timings here vary by a few per cent, more would be noise."""


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
    """Print the rows as a table, if it is to be shown; write benchmarks/results/<name>.json, where there is a name.

    The file says the commit, the day (UTC), the processor, memory and versions beside the rows, numbers rounded to the
    digits that hold. Files of before that was so have no `commit`, `date`, `processor` and versions of libraries, and
    keep all digits: they are not written anew.
    """
    if shown:
        show(rows)
    if name is None:
        return
    RESULTS.mkdir(exist_ok=True)
    kept = {**provenance(), "settings": rounded(settings), "rows": rounded(rows)}
    (RESULTS / f"{name}.json").write_text(json.dumps(kept, indent=1) + "\n")


def kept(name: str) -> list[dict[str, Any]]:
    """The rows kept in benchmarks/results/<name>.json, none where there is no such file."""
    file = RESULTS / f"{name}.json"
    return list(json.loads(file.read_text())["rows"]) if file.exists() else []


def provenance() -> dict[str, Any]:
    """What a result must say to be compared with one of another day: code, day, machine, versions.

    `commit` is null and `changed` too where the folder is no checkout of git, or git is not there.
    """
    commit, changes = _git("rev-parse", "HEAD"), _git("status", "--porcelain")
    return {
        "commit": commit,
        # Results themselves are written while measuring: they do not make the code another one.
        "changed": None if changes is None else any("benchmarks/results/" not in line for line in changes.splitlines()),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": _processor(),
            "machine": platform.machine(),
            "system": platform.system(),
            "cores": os.cpu_count(),
            "memory GiB": rounded(psutil.virtual_memory().total / 2**30),
        },
        "versions": {"python": platform.python_version(), **_libraries()},
    }


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """A number to so many significant digits, whole units kept; mappings and sequences by element, all else as it
    is."""
    if isinstance(value, Mapping):
        return {key: rounded(v, digits) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(v, digits) for v in value]
    if not isinstance(value, float) or not math.isfinite(value) or value == 0:
        return value
    return round(float(value), max(0, digits - 1 - math.floor(math.log10(abs(value)))))


def _git(*words: str) -> str | None:
    try:
        return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _processor() -> str:
    """The model as the machine names it."""
    described = Path("/proc/cpuinfo")
    if described.exists():
        for line in described.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def installed(package: str) -> str | None:
    """Version of a package in this Python; None where it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _libraries() -> dict[str, str]:
    """{library: version} of everything the project depends on; a Python that is lent for its GPU may lack some."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [Requirement(line).name for line in project["dependencies"]]
    return {name: found for name in sorted(names, key=str.lower) if (found := installed(name))}


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
