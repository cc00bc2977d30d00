"""Planning at scale: finished sequences of up to 10,000 partitions, and simulated ones of up to 1,000,000.

    python -m benchmarks.pipeline.plan_scale [--finished 1250 5000 10000] [--simulated 10000 100000 1000000]

A partition is one unit of work: a stage's part of the time axis of one view or path, with a receipt of its own.
Finished sequences have true receipts over empty shards, all fresh, so a plan reads, parses and compares all of them. A
simulated one has none: every partition is to be made. Each size runs in a process of its own; the growth is the
exponent between one size and the one before it (1 = linear).
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.pipeline import synthetic
from benchmarks.report import publish
from posegaussian.dags.planning.selection import Selection


def plan_once(root: Path, count: int, finished: bool, repeats: int) -> dict[str, Any]:
    """Median seconds of planning about `count` partitions, and the process's peak memory."""
    session = synthetic.make(root, max(1, round(count / synthetic.TASKS)), receipts=finished)
    wall, processor = [], []
    for _ in range(repeats):
        start, cpu = time.perf_counter(), time.process_time()
        plan = session.plan(synthetic.NAME, Selection())
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - cpu)
    assert plan.all_fresh is finished
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "kind": "finished" if finished else "simulated",
        "partitions": len(plan.verdicts),
        "plan s": statistics.median(wall),
        "cpu s": statistics.median(processor),
        "peak MB": peak / 1e6,
    }


def in_a_process(count: int, finished: bool, repeats: int) -> dict[str, Any]:
    """`plan_once` in a fresh process, so that the peak is its own."""
    with tempfile.TemporaryDirectory() as folder:
        code = (
            "import json; from pathlib import Path; from benchmarks.pipeline.plan_scale import plan_once;"
            f" print(json.dumps(plan_once(Path({folder!r}), {count}, {finished}, {repeats})))"
        )
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def with_growth(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with the exponents of time and memory against the size before."""
    out: list[dict[str, Any]] = []
    for row in rows:
        before = out[-1] if out and out[-1]["kind"] == row["kind"] else None
        steps = math.log(row["partitions"] / before["partitions"]) if before else 0.0
        growth = {
            f"growth of {k}": f"{math.log(row[c] / before[c]) / steps:.2f}" if before else ""
            for k, c in (("time", "plan s"), ("memory", "peak MB"))
        }
        out.append({**row, **growth})
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--finished", type=int, nargs="*", default=[1250, 5000, 10000])
    parser.add_argument("--simulated", type=int, nargs="*", default=[10000, 100000, 1000000])
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    rows = [in_a_process(n, True, arguments.repeats) for n in arguments.finished]
    rows += [in_a_process(n, False, arguments.repeats if n <= 100000 else 1) for n in arguments.simulated]
    publish("plan_scale", with_growth(rows), vars(arguments))


if __name__ == "__main__":
    main()
