"""What a GPU makes of it, in one table: the GPU's tests, the renderer at 512, 1024 and 2048 px with gsplat beside it,
the network, steps of refinement, a whole frame, and training for some minutes.

    python -m benchmarks.gpu.table [--minutes 10] [--parts tests renderer ...] [--repeats 50] [--limit 20]

or `make gpu`, with `GPU_PYTHON=/path/to/python` for a Python of yours that has a CUDA build of torch, into which
nothing is installed. Each part runs in a process of its own, for --limit minutes at most, training beyond its own. Rows
are printed as they are measured, and once more as a table, which with a CUDA device is written, after every part, to
benchmarks/results/gpu.md and gpu.json.

Without one every part runs all the same, small and on the CPU, kernels in Triton's interpreter: so the command is
tested wherever it is changed. The table then says "not measured here" in every row that needs a device, and no file is
written. What a part lacks, Triton or another library, is said in its row. The exit status is 1 where a part failed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from benchmarks.gpu.part import PARTS, measured
from benchmarks.gpu.rows import Row, Setup
from benchmarks.processes import environment
from benchmarks.report import RESULTS, installed, provenance, publish, rounded

COLUMNS = ("what", "size", "figure", "unit", "on")
FILE = "gpu.md"


def circumstances(device: torch.device) -> dict[str, str]:
    """The builds and the device that figures belong to."""
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else "none that torch can use"
    beside = {n: installed(n) or "not installed" for n in ("triton", "gsplat")}
    return {"CUDA device": name, "torch": torch.__version__, **beside}


def run(part: str, words: Sequence[str], minutes: float) -> list[Row]:
    """The rows of a part; the last one says so where its process was ended or ended itself in the middle."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.jsonl"
        command = [sys.executable, "-m", "benchmarks.gpu.part", part, str(file), *words]
        try:
            status: int | None = subprocess.run(
                command, env=environment(), timeout=60 * minutes, check=False
            ).returncode
        except subprocess.TimeoutExpired:
            status = None
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    found = [Row(**json.loads(line)) for line in lines]
    if status is None:
        found.append(Row(part, "", f"ended after {minutes:g} minutes", wrong=True))
    elif status and not any(row.wrong for row in found):
        found.append(Row(part, "", f"its process ended with status {status}", wrong=True))
    return found


def markdown(rows: Sequence[Row], about: dict[str, str]) -> str:
    """The table, with what it belongs to above it."""
    head = "; ".join(f"{name}: {value}" for name, value in about.items())
    lines = [COLUMNS, ("---",) * len(COLUMNS), *(tuple(_cell(row, c) for c in COLUMNS) for row in rows)]
    return "\n".join([head, "", *("| " + " | ".join(line) + " |" for line in lines)]) + "\n"


def _cell(row: Row, column: str) -> str:
    value = getattr(row, column)
    return f"{rounded(value):,g}" if isinstance(value, float) else value.replace("|", "/")


def write(rows: Sequence[Row], about: dict[str, str], settings: dict[str, object]) -> None:
    """Both files."""
    publish("gpu", [{c: getattr(row, c) for c in COLUMNS} for row in rows], {**settings, **about}, shown=False)
    made = provenance()
    code = f"{made['commit']}{' and changes' if made['changed'] else ''}"
    text = markdown(rows, about | {"processor": made["machine"]["processor"], "commit": code, "date": made["date"]})
    (RESULTS / FILE).write_text(text, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the parts, print the table, and keep it where anything was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="of training; 0: none")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--repeats", type=int, default=Setup.repeats)
    parser.add_argument("--limit", type=float, default=20.0, help="minutes that a part may take")
    parser.add_argument("--training", type=Path, default=Setup.training, help="folder of the training")
    given = parser.parse_args(arguments)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    about, rows = circumstances(device), list[Row]()
    settings: dict[str, object] = {
        k: v if isinstance(v, int | float) else str(v) for k, v in vars(given).items() if k != "parts"
    }
    words = [w for k in ("minutes", "repeats", "training") for w in (f"--{k}", str(settings[k]))]
    for part in given.parts:
        print(f"--- {part}", flush=True)
        minutes, begun = given.limit + (given.minutes if part == "training" else 0), time.monotonic()
        rows += run(part, ["--device", device.type, *words], minutes)
        print(f"({time.monotonic() - begun:.0f} s)", flush=True)
        if any(measured(row) for row in rows):
            write(rows, about, settings)
    print("\n" + markdown(rows, about))
    sys.exit(any(row.wrong for row in rows))


if __name__ == "__main__":
    main()
