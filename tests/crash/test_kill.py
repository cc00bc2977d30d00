"""kill -9 in mid-run: whatever dies, the next run needs no flag and ends with the bytes of an undisturbed run."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film

ENOUGH = 9
"""Receipts on disk before the kill: some stages are past, most of the run is still to come (there are 50 tasks)."""

KILLS = 20
"""Of `make crash`."""


def start(pipeline: Pipeline, scheduler: str) -> subprocess.Popen:
    return pipeline.start(
        "--scheduler",
        scheduler,
        "--set",
        "run.workers=2",
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def wait_for_receipts(pipeline: Pipeline, process: subprocess.Popen, count: int) -> None:
    deadline = time.monotonic() + 120
    while len(list((pipeline.root / NAME / "_receipts").rglob("*.json"))) < count:
        assert process.poll() is None, f"the run ended with {process.returncode} before it could be killed"
        assert time.monotonic() < deadline, "the run made no progress"
        time.sleep(0.005)


def family(process: subprocess.Popen) -> list[psutil.Process]:
    return psutil.Process(process.pid).children(recursive=True)


def workers(processes: list[psutil.Process]) -> list[psutil.Process]:
    return [c for c in processes if any("spawn_main" in part for part in c.cmdline())]


def wait_gone(processes: list[psutil.Process]) -> None:
    """Workers end by themselves when their driver is gone;
    what is left after a while is ended here, so that no test leaks."""
    _, alive = psutil.wait_procs(processes, timeout=60)
    for p in alive:
        p.kill()
    assert not alive, f"workers outlived their driver by a minute: {alive}"


@pytest.mark.parametrize(("victim", "scheduler"), [("driver", "serial"), ("driver", "local"), ("worker", "local")])
def test_the_next_run_ends_with_the_bytes_of_an_undisturbed_one(
    victim: str, scheduler: str, finished: Pipeline, tmp_path: Path
) -> None:
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
        found = workers(children)
        assert found, "no worker process was found"
        found[0].kill()
        assert process.wait(timeout=200) == 0, "the run must survive the death of a worker"
    if victim == "driver":
        assert not pipeline.plan().all_fresh, "the kill came too late to prove anything"
    pipeline.run()
    assert pipeline.plan().all_fresh
    assert_same_content(content(pipeline), content(finished))


def tokens(pipeline: Pipeline) -> dict[tuple, str]:
    """{task: token of the attempt that wrote its receipt}."""
    sequence = Archive.open(str(pipeline.root)).sequence(NAME)
    return {(r.stage, r.partition, r.view, r.path): r.facts["token"] for r in scan_receipts(sequence)}


def killed_at_random(pipeline: Pipeline, chance: random.Random, longest: float) -> tuple[str, float]:
    """Start a run and kill -9 its driver or a worker at a random moment; a run that lost a worker is let go on.
    Returns (who, when)."""
    process = start(pipeline, chance.choice(["local", "local", "serial"]))
    moment = chance.uniform(0.3, longest)
    time.sleep(moment)
    if process.poll() is not None:
        return "nobody: the run was over", moment
    children = family(process)
    found = workers(children)
    if found and chance.random() < 0.4:
        chance.choice(found).kill()
        process.wait(timeout=280)
        return "worker", moment
    process.send_signal(signal.SIGKILL)
    process.wait()
    wait_gone(children)
    return "driver", moment


@pytest.mark.crash
@pytest.mark.timeout(3600)
def test_many_kills_at_random_moments_leave_the_bytes_of_an_undisturbed_run(tmp_path: Path) -> None:
    """Nothing is computed twice after its receipt: the token of every receipt that was there stays."""
    film(tmp_path / "capture", views=6, size=48, frames=12, held_out=1)
    whole = Pipeline(tmp_path / "whole", tmp_path / "capture")
    whole.register()
    begin = time.monotonic()
    assert start(whole, "local").wait() == 0
    longest = time.monotonic() - begin
    chance = random.Random(3)
    kills, round_, pipeline = 0, 0, whole
    while kills < KILLS:
        if pipeline.plan().all_fresh:
            if round_:
                assert_same_content(content(pipeline), content(whole))
            round_ += 1
            pipeline = Pipeline(tmp_path / f"archive{round_}", tmp_path / "capture")
            pipeline.register()
        before = tokens(pipeline)
        who, moment = killed_at_random(pipeline, chance, longest)
        kills += who in ("driver", "worker")
        after = tokens(pipeline)
        print(f"kill {kills}: {who} after {moment:.1f} s, receipts {len(before)} -> {len(after)}", flush=True)
        assert {k: after.get(k) for k in before} == before, "a finished task was computed again"
    pipeline.run()
    assert pipeline.plan().all_fresh
    assert_same_content(content(pipeline), content(whole))
