"""Peak memory of a run against its limit, while the archive is many times larger; projected beside measured, stage by
stage.

    python -m benchmarks.pipeline.memory [--frames 260] [--size 320] [--limit 3072]

The limit is `run.memory`: what the single worker may take, interpreter and libraries included. The run is one process
(serial); the driver's own memory is in its peak. The archive is long rather than wide, because it is length that must
not cost memory: the peak of the last tasks is compared with that of the first ones as well.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.report import publish
from posegaussian.dags.simulation.demo import film
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.store import Archive

CLI = [sys.executable, "-m", "posegaussian.dags.cli.app"]


def settings(limit: float, partition: int) -> list[str]:
    """`--set` of the runs measured here."""
    chosen = {
        "views.held_out": "[mid00]",
        "rendering.paths": "[held_out]",
        "run.memory": limit,
        "run.scheduler": "serial",
        "partition.frames": partition,
        "depth.method": "hull",
    }
    return [part for k, v in chosen.items() for part in ("--set", f"{k}={v}")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=260, help="frames that are filmed")
    parser.add_argument("--size", type=int, default=320, help="side of the pictures, px")
    parser.add_argument("--partition", type=int, default=2, help="frames of a partition")
    parser.add_argument("--limit", type=float, default=3072.0, help="memory of the worker, MiB")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows, facts = measure(Path(folder), options)
    publish("memory", rows, vars(options) | facts)
    for name, value in facts.items():
        print(f"{name}: {value}")
    if facts["peak of any task MiB"] > options.limit:
        sys.exit("the peak is above the limit")


def measure(folder: Path, options: argparse.Namespace) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """(rows by stage, figures of the whole run)."""
    film(folder / "capture", options.size, options.frames, Console(quiet=True))
    archive = ["--archive", str(folder / "archive")]
    given = settings(options.limit, options.partition)
    for command in (
        ["import", "images", str(folder / "capture"), "--sequence", "s", *archive, *given],
        ["run", *archive, *given],
    ):
        subprocess.run([*CLI, *command], check=True, stdout=subprocess.DEVNULL)
    tasks: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in sorted(ledger.read(Archive(folder / "archive")), key=lambda r: r["started"]):
        tasks[row["stage"]].append(row)
    rows = []
    for stage, found in tasks.items():
        peaks = [r["peak_rss"] / 2**20 for r in found]
        tenth = max(1, len(peaks) // 10)
        rows.append(
            {
                "stage": stage,
                "tasks": len(found),
                "projected MiB": found[0]["projected_ram"] / 2**20,
                "peak MiB": max(peaks),
                "first tenth MiB": max(peaks[:tenth]),
                "last tenth MiB": max(peaks[-tenth:]),
                "raw MiB": sum(r["raw_bytes"] for r in found) / 2**20,
                "disk MiB": sum(r["bytes"] for r in found) / 2**20,
            }
        )
    raw = sum(r["raw MiB"] for r in rows)
    return rows, {
        "archive MiB": round(raw, 1),
        "peak of any task MiB": round(max(r["peak MiB"] for r in rows), 1),
        "archive over limit": round(raw / options.limit, 2),
    }


if __name__ == "__main__":
    main()
