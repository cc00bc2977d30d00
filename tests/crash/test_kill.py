"""kill -9 in mid-run: whatever dies, the next run needs no flag and ends with the bytes of an undisturbed run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.pipeline import NAME, Pipeline, assert_same_content, content

ENOUGH = 9
"""Receipts on disk before the kill: some stages are past, most of the run is still to come (there are 50 tasks)."""


def start(pipeline: Pipeline, scheduler: str) -> subprocess.Popen:
    settings = [f"views.held_out={pipeline.held_out}", f"partition.frames={pipeline.partition}", "run.workers=2"]
    command = [sys.executable, "-m", "dags.cli", "run", "--archive", str(pipeline.root), "--scheduler", scheduler]
    for s in settings:
        command += ["--set", s]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=pipeline.root, env={**os.environ, "PYTHONPATH": os.getcwd()}, start_new_session=True)


def wait_for_receipts(pipeline: Pipeline, process: subprocess.Popen, count: int) -> None:
    deadline = time.monotonic() + 120
    while len(list((pipeline.root / NAME / "_receipts").rglob("*.json"))) < count:
        assert process.poll() is None, f"the run ended with {process.returncode} before it could be killed"
        assert time.monotonic() < deadline, "the run made no progress"
        time.sleep(0.005)


def family(process: subprocess.Popen) -> list[psutil.Process]:
    return psutil.Process(process.pid).children(recursive=True)


def wait_gone(processes: list[psutil.Process]) -> None:
    """Workers end by themselves when their driver is gone; what is left after a while is ended here, so that no test leaks."""
    _, alive = psutil.wait_procs(processes, timeout=60)
    for p in alive:
        p.kill()
    assert not alive, f"workers outlived their driver by a minute: {alive}"


@pytest.mark.parametrize(("victim", "scheduler"), [("driver", "serial"), ("driver", "local"), ("worker", "local")])
def test_the_next_run_ends_with_the_bytes_of_an_undisturbed_one(victim: str, scheduler: str, finished: Pipeline, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", finished.folder)
    pipeline.register()
    process = start(pipeline, scheduler)
    wait_for_receipts(pipeline, process, ENOUGH)
    children = family(process)
    if victim == "driver":
        process.send_signal(signal.SIGKILL)
        process.wait()
        wait_gone(children)
    else:
        workers = [c for c in children if any("spawn_main" in part for part in c.cmdline())]
        assert workers, "no worker process was found"
        workers[0].kill()
        assert process.wait(timeout=200) == 0, "the run must survive the death of a worker"
    if victim == "driver":
        assert not pipeline.plan().all_fresh, "the kill came too late to prove anything"
    pipeline.run()
    assert pipeline.plan().all_fresh
    assert_same_content(content(pipeline), content(finished))
