"""A task beyond `run.timeout` is ended with its process, whatever it is stuck in, and the run goes on in a new one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.provenance import builds
from posegaussian.dags.runtime import in_flight
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed, TaskRetried
from posegaussian.dags.runtime.executors import child
from posegaussian.dags.runtime.executors.dask import DaskBackend
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import living
from posegaussian.storage.archive.receipts import scan_receipts
from tests.support import sabotage
from tests.support.clusters import Cluster
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content

GAUSSIANS = Selection(only=frozenset({"gaussians"}), force=frozenset({"gaussians"}))


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def run(
    pipeline: Pipeline, timeout: float, selection: Selection = GAUSSIANS, backend: SerialBackend | None = None
) -> list[Event]:
    events: list[Event] = []
    Run(
        [pipeline.plan(selection=selection)],
        selection,
        backend or SerialBackend(),
        [events.append],
        rules=Rules(RunTerms("r", timeout=timeout)),
    ).go()
    return events


def of(events: list[Event], kind: type) -> list:
    return [e for e in events if isinstance(e, kind)]


@pytest.mark.parametrize(
    "serve", [sabotage.stuck_in_numba, sabotage.stuck_with_the_interpreter], ids=lambda f: f.__name__
)
def test_a_task_beyond_its_time_ends_with_its_process_and_the_next_one_gets_another(
    archive: Pipeline, serve: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child, "serve", serve)
    before = content(archive)
    events = run(archive, 4.0)  # more than the other tasks take on a busy machine
    (failed,) = of(events, TaskFailed)
    assert (failed.kind, failed.task.partition) == ("timed out", 1)
    assert (
        failed.error
        == "it took longer than 4 s (run.timeout); raise run.timeout, or import with a smaller partition.frames"
    )
    assert "sabotage.py" in failed.details, "it says where the task was"
    assert not of(events, TaskRetried)
    done = of(events, TaskDone)
    assert {e.task.partition for e in done} == {0, 2}
    assert len({e.receipt.facts["pid"] for e in done} - {os.getpid()}) == 2, (
        "a process before the limit and another one after it"
    )
    assert not list(living(archive.root / NAME / "_receipts")), "nobody waits for the ended one"
    assert not multiprocessing.active_children()
    monkeypatch.undo()
    archive.run()
    assert_same_content(content(archive), before)


def test_with_a_limit_one_child_computes_everything_to_the_same_bytes(archive: Pipeline, finished: Pipeline) -> None:
    selection = Selection(force=frozenset({"smoothing", "gaussians", "rendering", "metrics"}))
    events = run(archive, 600.0, selection)
    pids = {e.receipt.facts["pid"] for e in of(events, TaskDone)}
    assert len(of(events, TaskDone)) >= 9
    assert len(pids) == 1
    assert pids != {os.getpid()}
    assert_same_content(content(archive), content(finished))
    facts = next(r for r in scan_receipts(archive.context().sequence) if r.facts["run"] == "r").facts
    assert facts["worker"] == "main"


def test_without_a_limit_there_is_no_child(archive: Pipeline) -> None:
    events = archive.run(selection=GAUSSIANS)
    assert {e.receipt.facts["pid"] for e in of(events, TaskDone)} == {os.getpid()}


def test_a_child_that_is_killed_is_a_worker_that_died(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """By another thread, as the second Ctrl-C does."""
    monkeypatch.setattr(child, "serve", sabotage.stuck_with_the_interpreter)
    backend = SerialBackend()

    def kill_what_is_stuck() -> None:
        for _ in range(2):  # it is tried once more
            while not any("p000001" in f.name for f, _ in living(archive.root / NAME / "_receipts")):
                time.sleep(0.01)
            time.sleep(0.2)
            backend.kill()

    killer = threading.Thread(target=kill_what_is_stuck, daemon=True)
    killer.start()
    (failed,) = of(run(archive, 600.0, backend=backend), TaskFailed)
    killer.join()
    assert failed.kind == "memory or crash"
    assert failed.error.startswith("its worker main died: killed for memory, or crashed; it was tried once more alone")


def test_a_child_that_never_begins_fails_the_task_and_not_for_ever(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child, "serve", sabotage.dead_on_arrival)
    monkeypatch.setattr(in_flight, "MOST_SPARED", 0)
    events = run(archive, 600.0)
    assert {e.kind for e in of(events, TaskFailed)} == {"memory or crash"}
    assert not of(events, TaskDone)


def test_a_child_that_imports_other_code_than_the_run_computes_nothing(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = archive.plan(selection=GAUSSIANS)
    own = builds.here()
    monkeypatch.setattr(builds, "here", lambda: builds.Build({**own.versions, "stages/depth/run.py": "x"}, "f" * 32))
    events: list[Event] = []
    Run([plan], GAUSSIANS, SerialBackend(), [events.append], rules=Rules(RunTerms("r", timeout=600.0))).go()
    failed = of(events, TaskFailed)
    assert {e.kind for e in failed} == {"other code"}
    assert "has other code or libraries than this run: stages/depth/run.py (" in failed[0].error
    assert failed[0].error.endswith("files were edited since the run began: run again")
    assert not of(events, TaskDone)


def test_the_child_of_a_killed_run_ends_too(person_folder: Path, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder, ["run.timeout=600"])
    pipeline.register()
    process = pipeline.start(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not list((pipeline.root / NAME / "_receipts").rglob("*.json")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    family = psutil.Process(process.pid).children(recursive=True)
    assert family
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not psutil.wait_procs(family, timeout=20)[1]
    assert not list(living(pipeline.root / NAME / "_receipts"))


def test_two_limits_in_one_process_end_it_at_the_earlier_one(tmp_path: Path) -> None:
    """Workers of others may have several threads; what is over before its limit ends nothing."""
    code = f"""
import os, threading, time
from pathlib import Path
from posegaussian.dags.runtime.timeout import time_limit
from posegaussian.storage.archive.lease import Lease
def work(name, limit, seconds):
    with Lease.take(Path({str(tmp_path)!r}) / name, "r") as lease, time_limit(limit, lease):
        time.sleep(seconds)
    print(name, "is through", flush=True)
given = (("long.lease", 600, 60), ("quick.lease", 0.3, 0.1), ("short.lease", 1, 60))
threads = [threading.Thread(target=work, args=a, daemon=True) for a in given]
for t in threads: t.start()
for t in threads: t.join()
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=30,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    assert (done.returncode, done.stdout) == (1, "quick.lease is through\n"), done.stderr
    assert b"Timeout (0:00:0" in (tmp_path / "short.lease").read_bytes()
    assert b"Timeout" not in (tmp_path / "long.lease").read_bytes()
    assert not (tmp_path / "quick.lease").exists()


def test_a_scheduler_of_others_that_hands_a_dead_worker_s_task_out_again_computes_it_once(
    archive: Pipeline, tmp_path: Path
) -> None:
    """Dask's own scheduler allows a task three deaths; each would take as long as the limit, and a worker."""
    preload = tmp_path / "preload.py"
    preload.write_text("from tests.support.sabotage import stick\nstick()\n")
    with ExitStack() as stack:
        others = Cluster(stack, tmp_path / "scheduler.json")
        for name in ("a", "b"):
            others.add(name, "--preload", str(preload))
        backend = DaskBackend(RunSettings(scheduler=others.address()), archive.root)
        events: list[Event] = []
        rules = Rules(RunTerms("r", timeout=5.0))
        Run([archive.plan(selection=GAUSSIANS)], GAUSSIANS, backend, [events.append], rules=rules).go()
    (failed,) = of(events, TaskFailed)
    assert (failed.kind, failed.task.partition) == ("timed out", 1)
    assert failed.error.startswith("it took longer than 5 s (run.timeout); raise run.timeout")
    assert {e.task.partition for e in of(events, TaskDone)} == {0, 2}, "one of two workers is left"
