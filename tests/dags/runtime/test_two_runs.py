"""Two runs on one archive: each is told who works on what, nothing is computed twice,
nobody's arrays are pulled away."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import cast
from unittest.mock import Mock

import pytest
from rich.console import Console

from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime import entering, run_registry, scheduler
from posegaussian.dags.runtime.events import Event, Notice, TaskDone, TaskFailed, TaskFresh
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.failures import Kind
from posegaussian.dags.runtime.leases import HeldTasks
from posegaussian.dags.runtime.ordering import counted_on
from posegaussian.dags.runtime.run_registry import folder
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import RunTerms, WorkOrder
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive.lease import Holder, Lease, read_lease
from posegaussian.storage.archive.receipts import ReceiptKey, lease_file
from posegaussian.storage.model.errors import ArchiveError, NotWritten
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, ended, receipts
from tests.support.sample_captures import make_sequence

DEPTH = Selection(start="depth")
KEY = ReceiptKey("depth", 1, None, None)


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def failures(events: list[Event]) -> list[TaskFailed]:
    return [e for e in events if isinstance(e, TaskFailed)]


HOLDER = """
import sys
from pathlib import Path
from posegaussian.storage.archive.lease import Lease
Lease.take(Path(sys.argv[1]), "the-other-run", "cpu-7")
print("there", flush=True)
sys.stdin.read()
"""


@contextmanager
def holding(file: Path) -> Iterator[subprocess.Popen]:
    """A process that holds a lease until it is killed."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    ) as other:
        try:
            assert other.stdout is not None
            other.stdout.readline()
            yield other
        finally:
            other.kill()


@pytest.mark.parametrize("how", ["gives it up", "is killed", "finishes it"])
def test_what_another_run_holds_is_waited_for_by_name_and_done_when_it_is_free(
    archive: Pipeline, finished: Pipeline, how: str
) -> None:
    file = lease_file(archive.context().sequence, ReceiptKey("depth", 1, None, None))
    events: list[Event] = []
    with holding(file) as other:

        def tell(event: Event) -> None:
            events.append(event)
            if isinstance(event, Notice):
                other.kill()
                other.wait()
                if how == "gives it up":
                    file.unlink()
                elif how == "finishes it":
                    archive.run(selection=Selection(only=frozenset({"depth"}), force=frozenset({"depth"})))

        Run([archive.plan(selection=DEPTH)], DEPTH, SerialBackend(), [tell]).go()
    (waited,) = [e for e in events if isinstance(e, Notice)]
    assert f"waiting for run the-other-run, worker cpu-7 (process {other.pid} on " in waited.sentence
    assert "which works on person depth p0001; what it gives up is done here" in waited.sentence
    settled = [(type(e), e.task.stage, e.task.partition) for e in events if isinstance(e, TaskDone | TaskFresh)]
    before = set(settled[: settled.index((TaskDone if how != "finishes it" else TaskFresh, "depth", 1))])
    assert {
        (TaskDone, "depth", 0),
        (TaskDone, "depth", 2),
        (TaskDone, "gaussians", 0),
        (TaskDone, "rendering", 2),
    } <= before, "all else was done first"
    assert (TaskDone, "rendering", 1) in settled
    assert (ended(events).failed, ended(events).blocked) == (0, 0)
    assert_same_content(content(archive), content(finished))


def test_a_lease_from_the_future_that_nobody_renews_frees_its_task_for_any_worker(tmp_path: Path) -> None:
    sequence = make_sequence(tmp_path)
    file, order = lease_file(sequence, KEY), SimpleNamespace(root=sequence.root, key=KEY)
    later = time.time() + 7200
    holder = Holder("0" * 32, "ahead", "main", "elsewhere", "another boot", 7, 1.0, later, later + 0.3, "", 0.3)
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps(asdict(holder)) + "\n")
    held = HeldTasks(60.0)
    held.add(Task("person", *KEY), (0, 0), cast(WorkOrder, order), holder)
    looked, freed = time.monotonic(), []
    while not freed:
        assert time.monotonic() < looked + 30
        freed = list(held.freed())
    assert time.monotonic() > looked + 0.3
    assert not file.exists(), "a worker, which has not waited, takes it"


def test_ctrl_c_ends_a_wait(archive: Pipeline) -> None:
    with holding(lease_file(archive.context().sequence, ReceiptKey("depth", 1, None, None))):
        waiting = archive.start("--only", "depth", "--force", "depth", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert waiting.stdout is not None
        said = ""
        while "waiting for run the-other-run" not in said:
            line = waiting.stdout.readline()
            assert line, said
            said += line
        waiting.send_signal(signal.SIGINT)
        said += waiting.communicate(timeout=60)[0]
    assert waiting.returncode == 130, said
    assert "Traceback" not in said, said
    assert "2 done, " in said, said


AT_ONCE = """
import sys, time
import posegaussian.stages.peers.run as rendering
real = rendering.run
def slow(inputs, params):
    time.sleep(1.0)  # so that they meet
    return real(inputs, params)
rendering.run = slow
from posegaussian.dags.cli.app import main
print("ready", flush=True)
sys.stdin.readline()
main()
"""


def test_three_runs_and_an_export_of_one_path_make_it_once_and_all_succeed(archive: Pipeline, tmp_path: Path) -> None:
    run = ["run", *archive.options, "--path", "still mid00"]
    export = ["export", NAME, *archive.options, "--path", "still mid00", "--frames", str(tmp_path / "pictures")]
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", AT_ONCE, *words],
            cwd=archive.root,
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        for words in (run, run, run, export)
    ]
    for p in processes:
        assert p.stdout is not None
        assert p.stdout.readline() == "ready\n"
    for p in processes:
        assert p.stdin is not None
        p.stdin.write("go\n")
        p.stdin.flush()
    said = [p.communicate(timeout=200)[0] for p in processes]
    assert [p.returncode for p in processes] == [0, 0, 0, 0], "\n".join(said)
    log = [
        json.loads(line) for f in (archive.root / "_runs").rglob("events.jsonl") for line in f.read_text().splitlines()
    ]
    made = sorted(e["partition"] for e in log if e["event"] == "task_done" and e["stage"] == "rendering")
    assert made == [0, 1, 2], "every partition of the path was made once"
    assert len(list((tmp_path / "pictures").rglob("*.png"))) == 6


def test_what_another_run_finished_in_the_meantime_is_taken_as_it_is(archive: Pipeline) -> None:
    """The plan is made, then another run does all of it: this run computes nothing and goes on to the end."""
    changed = archive.with_settings("gaussians.footprint=0.6")
    events: list[Event] = []
    run = Run([changed.plan()], Selection(), SerialBackend(), [events.append])
    judged = run.flight.add
    first = True

    def other_run_is_quicker(*task: object) -> None:
        nonlocal first
        if first:
            first = False
            changed.run()
        judged(*task)  # type: ignore[arg-type]

    run.flight.add = other_run_is_quicker  # type: ignore[method-assign]
    run.go()
    assert not [e for e in events if isinstance(e, TaskDone)]
    assert {e.task.stage for e in events if isinstance(e, TaskFresh)} >= {"gaussians", "rendering", "metrics"}
    assert ended(events).failed == 0


def test_a_run_says_at_its_start_who_else_is_at_work(archive: Pipeline) -> None:
    changed = archive.with_settings("gaussians.footprint=0.6")
    with holding(folder(archive.context().sequence) / "the-other-run.lease") as other:
        console = Console(file=io.StringIO(), width=400)
        status = Session(changed.configuration, str(archive.root), console).run_and_report(
            [changed.plan()], Selection()
        )
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert status == 0, said
    assert f"person: run the-other-run, worker cpu-7 (process {other.pid} on " in said
    assert "is at work here, too; what it holds is waited for" in said


def started(pipeline: Pipeline, trace: str) -> subprocess.Popen:
    """A run as a process of its own that has left a trace among the sequence's receipts."""
    other = pipeline.start(stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    deadline = time.monotonic() + 100
    while not list((pipeline.root / NAME / "_receipts").rglob(trace)):
        assert other.poll() is None, other.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return other


def test_two_runs_at_once_share_the_work_and_end_with_the_bytes_of_one(finished: Pipeline, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", finished.folder)
    pipeline.register()
    other = started(pipeline, "*.json")
    mine = pipeline.run()
    said = other.communicate(timeout=200)[0]
    assert other.returncode == 0, said
    done = [e.task for e in mine if isinstance(e, TaskDone)]
    assert done, "the second run worked too"
    log = "".join(f.read_text() for f in (pipeline.root / "_runs").rglob("events.jsonl"))
    assert log.count('"task_done"') + len(done) == len(pipeline.plan().verdicts), "every task was computed once"
    assert pipeline.plan().all_fresh
    assert_same_content(content(pipeline), content(finished))


SLEEPER = """
import sys, time
from pathlib import Path
import posegaussian.stages.depth.run as depth
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.work_order import RunTerms
from tests.support.pipeline import Pipeline

root, folder, flag = map(Path, sys.argv[1:])
real = depth.run
def slow(inputs, params):
    for i, block in enumerate(real(inputs, params)):
        yield block
        if i == 1 and inputs.partition.start == 2:
            flag.touch()
            time.sleep(0.5)
depth.run = slow
pipeline = Pipeline(root, folder, ["depth.consistency=0.9"])
def tell(event):
    print(type(event).__name__, getattr(event, "task", None), getattr(event, "error", ""), flush=True)
only = Selection(only=frozenset({"depth"}))
Run([pipeline.plan(selection=only)], only, SerialBackend(), [tell], rules=Rules(RunTerms("sleeper", lease=1.0))).go()
"""


def state(root: Path) -> dict[str, tuple[int, int]]:
    """{file: (inode, time of change)} of every file of the sequence but those that say who is there."""
    return {
        str(p): (p.stat().st_ino, p.stat().st_mtime_ns)
        for p in sorted((root / NAME).rglob("*"))
        if p.is_file() and p.suffix not in (".lease", ".arrays", ".partial")
    }


def test_a_writer_suspended_past_its_lease_and_woken_writes_nothing(archive: Pipeline, tmp_path: Path) -> None:
    archive = archive.with_settings("depth.consistency=0.9")
    flag = tmp_path / "asleep"
    writer = subprocess.Popen(
        [sys.executable, "-c", SLEEPER, str(archive.root), str(archive.folder), str(flag)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    try:
        deadline = time.monotonic() + 100
        while not flag.exists():
            assert writer.poll() is None, writer.communicate()[0]
            assert time.monotonic() < deadline
            time.sleep(0.005)
        writer.send_signal(signal.SIGSTOP)
        time.sleep(1.2)  # past its lease
        archive.run(selection=Selection(only=frozenset({"depth"})), expect_failure=True)
        assert archive.plan().counts("depth") == {State.FRESH: 3}
        before, whole = state(archive.root), content(archive)
    finally:
        writer.send_signal(signal.SIGCONT)
    said = writer.communicate(timeout=100)[0]
    assert writer.returncode == 0, said
    assert "TaskRetried" in said, said
    assert "stops and writes nothing more" in said, said
    assert "TaskDone" not in said.partition("TaskRetried")[2], "what the other run had finished was taken as it is"
    assert state(archive.root) == before
    assert_same_content(content(archive), whole)


@pytest.mark.parametrize("says", ["nothing", "that it counts on them as they are"])
def test_arrays_are_not_replaced_under_another_run(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch, says: str
) -> None:
    monkeypatch.setattr(run_registry, "PATIENCE", 0.1)
    before = content(archive)
    sequence = archive.context().sequence
    with Lease.take(folder(sequence) / "the-other-run.lease", "the-other-run", "driver"):
        if says != "nothing":
            run_registry.count_on(sequence, RunTerms("the-other-run"), counted_on(archive.plan()))
        events = archive.with_settings("frames.size=32").run(expect_failure=True)
        assert_same_content(content(archive), before)
    (refused,) = failures(events)
    assert "must be replaced for these settings, but run the-other-run" in refused.error
    assert ended(events).done == 0


@pytest.fixture
def waiting(archive: Pipeline) -> Pipeline:
    """Settings for which arrays are replaced, of stages that wait for the survey, which is yet to be taken."""
    return archive.with_settings("frames.size=32", "views.trust=auto")


@pytest.mark.parametrize("by", ["another run", "the disk"])
def test_a_run_that_gets_no_arrays_once_the_survey_is_through_ends_there(
    archive: Pipeline, waiting: Pipeline, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    """What is there belongs to whoever made it: of the other run not one receipt goes."""
    before, kept = content(archive), receipts(archive)
    sequence = archive.context().sequence
    if by == "the disk":
        full = NotWritten(errno.ENOSPC, "cannot write frames/color: the disk is full")
        monkeypatch.setattr(scheduler, "make_arrays", Mock(side_effect=full))
    with Lease.take(folder(sequence) / "the-other-run.lease", "the-other-run", "driver") as other:
        run_registry.count_on(sequence, RunTerms("the-other-run"), counted_on(archive.plan()))
        if by == "the disk":
            other.drop()
        events = waiting.run(expect_failure=True)
    (refused,) = failures(events)
    if by == "the disk":
        assert "the disk is full" in refused.error
    else:
        assert "must be replaced for these settings, but run the-other-run" in refused.error
        assert refused.kind == Kind.HELD.value
    assert refused.details == ""
    done = {e.task.stage for e in events if isinstance(e, TaskDone)}
    assert done == {"survey"}
    assert ended(events).blocked == sum(t.stage != "survey" for t in waiting.plan().verdicts) - 1
    assert kept.items() <= receipts(archive).items()
    assert_same_content(content(archive, ("survey",)), {k: v for k, v in before.items() if not k.startswith("survey")})


def test_a_task_whose_array_another_run_replaced_removes_no_receipt_of_that_run(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, kept = content(archive), receipts(archive)
    monkeypatch.setattr(entering, "prepare", lambda plan: None)  # as if they had been made, and then replaced again
    events = archive.with_settings("frames.size=32").run(expect_failure=True)
    assert {f.task.stage for f in failures(events)} == {"frames", "pose"}
    for f in failures(events):
        assert "another run with other settings replaced it" in f.error
        assert f.details == ""
    assert receipts(archive) == kept
    assert_same_content(content(archive), before)


def test_two_runs_of_settings_for_which_arrays_are_replaced_share_the_work(archive: Pipeline) -> None:
    """Each counts on the arrays that the other one makes."""
    smaller = archive.with_settings("frames.size=32")
    other = started(smaller, "_runs/*.lease")
    mine = smaller.run()
    said = other.communicate(timeout=200)[0]
    assert other.returncode == 0, said
    assert ended(mine).done > 0, "the second run worked too"
    assert smaller.plan().all_fresh
    assert not list(folder(archive.context().sequence).iterdir()), "who leaves says nothing any more"


def test_of_all_that_is_fresh_arrays_are_described_anew_by_one_at_a_time(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two runs on one sequence have nothing to compute: under one name the second would take the first one's lease."""
    plan, names, real = archive.plan(), [], entering.prepare

    def prepare(plan: Plan) -> None:
        holder = read_lease(plan.context.sequence.receipts / "_arrays.lease", 60.0)
        assert holder is not None
        names.append(holder.run)
        real(plan)

    monkeypatch.setattr(entering, "prepare", prepare)
    for _ in range(2):
        (archive.root / NAME / "frames/size/zarr.json").unlink()
        assert archive.session.run_and_report([plan], Selection()) == 0
    assert len(set(names)) == 2
    assert (archive.root / NAME / "frames/size/zarr.json").is_file()
    assert not list(folder(plan.context.sequence).iterdir())


def test_an_input_that_another_run_replaced_meanwhile_fails_the_task_that_read_it(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    import posegaussian.stages.gaussians.run as gaussians

    real = gaussians.run

    def overtaken(inputs: object, params: object) -> object:
        yield from real(inputs, params)  # type: ignore[arg-type]
        monkeypatch.setattr(gaussians, "run", real)
        archive.with_settings("depth.consistency=0.5").run(
            selection=Selection(only=frozenset({"depth"})), expect_failure=True
        )

    monkeypatch.setattr(gaussians, "run", overtaken)
    events = archive.run(selection=Selection(start="gaussians"), expect_failure=True)
    errors = {f.error for f in failures(events)}
    assert any("by another run while gaussians read it" in e for e in errors), errors
    assert ArchiveError.__name__ not in "".join(errors)
