"""Seconds of `posegaussian plan` as a process after a finished run, and of the interpreter alone beside it.

python -m benchmarks.pipeline.plan_time [--repeats 7]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import ROOT, publish

CLI = [sys.executable, "-m", "posegaussian.dags.cli.app"]


def seconds(command: list[str], repeats: int) -> list[float]:
    """Wall seconds of a command over some repeats."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        found.append(time.perf_counter() - start)
    return found


def main() -> None:
    """Run the demo small, then time its plan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "demo"
        subprocess.run(
            [*CLI, "demo", "--output", str(output), "--size", "64", "--frames", "16"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        settings = str(ROOT / "dags" / "simulation" / "demo.yaml")
        plan = [*CLI, "plan", "--archive", str(output / "archive"), "--config", settings]
        assert "all fresh" in subprocess.run(plan, check=True, capture_output=True, text=True).stdout
        timed = {"plan": seconds(plan, repeats), "python -c pass": seconds([sys.executable, "-c", "pass"], repeats)}
    rows = [
        {"command": name, "min s": min(t), "median s": statistics.median(t), "max s": max(t)}
        for name, t in timed.items()
    ]
    publish("plan_time", rows, {"repeats": repeats})


if __name__ == "__main__":
    main()
