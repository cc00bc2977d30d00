"""`posegaussian status` and `plan` as processes, and the ledger rebuilt from scratch, over an archive of 10,000 partitions.

    python -m benchmarks.status_time [--partitions 10000] [--repeats 5]

The archive is synthetic: true receipts over empty shards (benchmarks/synthetic.py). The interpreter and the imports are
part of the commands; `status --help` shows their share. A run leaves the status worked out for the next `status`; after
other changes the first one works it out.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import synthetic
from benchmarks.plan_time import seconds
from benchmarks.report import publish
from dags.status import CACHE
from storage import ledger

CLI = [sys.executable, "-m", "dags.cli"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--partitions", type=int, default=10000)
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
        timed |= {name: seconds([*CLI, *words], arguments.repeats) for name, words in (("status, after a run", ["status", *given]), ("plan", ["plan", *given]), ("status --help (start alone)", ["status", "--help"]))}
        timed["ledger rebuilt"] = []
        for _ in range(arguments.repeats):
            start = time.perf_counter()
            ledger.rebuild(session.archive)
            timed["ledger rebuilt"].append(time.perf_counter() - start)
        partitions = len(ledger.read(session.archive))
    publish("status_time", [{"command": name, "partitions": partitions, "min s": min(t), "median s": statistics.median(t), "max s": max(t)} for name, t in timed.items()], vars(arguments))


if __name__ == "__main__":
    main()
