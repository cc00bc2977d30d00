"""`posegaussian status` and `plan` as processes, and the ledger rebuilt from scratch, over an archive of 10,000
partitions.

    python -m benchmarks.pipeline.status_time [--partitions 10000] [--sequences 300] [--repeats 5]

Beside that one long sequence, the first `status` of many short ones of 24 tasks each, in seconds of the processor too.

The archive is synthetic: true receipts over empty shards (benchmarks/pipeline/synthetic.py). The interpreter and the
imports are part of the commands; `status --help` shows their share. A run leaves the status worked out for the next
`status`; after other changes the first one works it out.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.pipeline import synthetic
from benchmarks.pipeline.plan_time import seconds
from benchmarks.report import publish
from posegaussian.dags.diagnostics.status import CACHE
from posegaussian.storage.archive import ledger

CLI = [sys.executable, "-m", "posegaussian.dags.cli.app"]
PARTITIONS = 3
"""Of a short sequence: 24 tasks."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--partitions", type=int, default=10000)
    parser.add_argument("--sequences", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        session = synthetic.make(Path(folder), max(1, round(arguments.partitions / synthetic.TASKS)))
        given = ["--archive", folder, *(w for s in synthetic.SETTINGS for w in ("--set", s))]
        ledger.rebuild(session.archive)
        timed: dict[str, list[float]] = {"status, worked out": []}
        for _ in range(arguments.repeats):
            shutil.rmtree(Path(folder) / CACHE, ignore_errors=True)
            timed["status, worked out"] += seconds([*CLI, "status", *given], 1)
        timed |= {
            name: seconds([*CLI, *words], arguments.repeats)
            for name, words in (
                ("status, after a run", ["status", *given]),
                ("plan", ["plan", *given]),
                ("status --help (start alone)", ["status", "--help"]),
            )
        }
        timed["ledger rebuilt"] = []
        for _ in range(arguments.repeats):
            start = time.perf_counter()
            ledger.rebuild(session.archive)
            timed["ledger rebuilt"].append(time.perf_counter() - start)
        partitions = len(ledger.read(session.archive))
    rows = [_row(name, partitions, times) for name, times in timed.items()]
    publish("status_time", [*rows, *short_sequences(arguments.sequences, arguments.repeats)], vars(arguments))


def short_sequences(count: int, repeats: int) -> list[dict[str, Any]]:
    """The first `status` of many short sequences: seconds, and seconds of the processor."""
    with tempfile.TemporaryDirectory() as folder:
        session = synthetic.make_many(Path(folder), count, PARTITIONS)
        ledger.rebuild(session.archive)
        given = ["--archive", folder, *(w for s in synthetic.SETTINGS for w in ("--set", s))]
        times, processor = [], []
        for _ in range(repeats):
            shutil.rmtree(Path(folder) / CACHE, ignore_errors=True)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            times += seconds([*CLI, "status", *given], 1)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            processor.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        partitions = len(ledger.read(session.archive))
    name = f"status, worked out, of {count} sequences"
    return [_row(name, partitions, times), _row(f"{name}: processor", partitions, processor)]


def _row(command: str, partitions: int, times: list[float]) -> dict[str, Any]:
    return {
        "command": command,
        "partitions": partitions,
        "min s": min(times),
        "median s": statistics.median(times),
        "max s": max(times),
    }


if __name__ == "__main__":
    main()
