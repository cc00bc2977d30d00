"""Ctrl-C: a run ends in order at the first one, at once at the second one, and the next run goes on from there."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.planning.plan import State
from posegaussian.dags.runtime.signals import interruptible
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive.lease import living
from tests.support.pipeline import NAME, Pipeline


def started(pipeline: Pipeline, scheduler: str, receipts: int, *more: str) -> subprocess.Popen:
    """A run in a process group of its own, with some receipts written."""
    process = pipeline.start(
        "--scheduler",
        scheduler,
        "--set",
        "run.workers=2",
        *more,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120
    while len(list((pipeline.root / NAME / "_receipts").rglob("*.json"))) < receipts:
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.005)
    return process


@pytest.mark.parametrize(
    ("scheduler", "more"),
    [("serial", ()), ("serial", ("--set", "run.timeout=600")), ("local", ())],
    ids=["serial", "serial with a child", "local"],
)
def test_ctrl_c_ends_a_run_in_order(scheduler: str, more: tuple[str, ...], person_folder: Path, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder)
    pipeline.register()
    process = started(pipeline, scheduler, 9, *more)
    family = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 130, said
    assert "Ctrl-C once more ends at once" in said
    assert "interrupted; what is done is kept, the next run goes on from here" in said
    assert " done, " in said
    assert f"\nnext: posegaussian run --archive {pipeline.root} --set " in said, said
    assert "Traceback" not in said, said
    psutil.wait_procs(family, timeout=30)
    assert not list(living(pipeline.root / NAME / "_receipts")), "no lease is left that anybody would wait for"
    plan = pipeline.plan()
    assert not plan.all_fresh
    assert plan.counts("frames")[State.FRESH], "what was done counts"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_workers_that_are_being_started_end_without_a_traceback(
    number: int, person_folder: Path, tmp_path: Path
) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder)
    pipeline.register()
    process = started(pipeline, "local", 0)
    deadline = time.monotonic() + 60
    while not (family := psutil.Process(process.pid).children(recursive=True)):
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.005)
    time.sleep(0.2)  # now they import
    os.killpg(process.pid, number)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 130, said
    assert said.endswith("interrupted; what is done is kept, the next run goes on from here\n"), said
    assert "Traceback" not in said, said
    assert not psutil.wait_procs(family, timeout=30)[1]


HANGING = """
import sys, time
import posegaussian.stages.frames.run as frames
def run(inputs, params):
    print("in the kernel", flush=True)
    time_is_up = time.monotonic() + 100
    import ctypes
    while time.monotonic() < time_is_up:
        try:
            ctypes.CDLL(None).usleep(100_000_000)  # one C call; the interpreter cannot raise within
        except KeyboardInterrupt:
            pass
    yield
frames.run = run
from posegaussian.dags.cli.app import main
sys.argv = ["posegaussian", *sys.argv[1:]]
main()
"""


def test_a_second_ctrl_c_ends_a_run_whose_kernel_does_not_listen(finished: Pipeline, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", finished.folder)
    pipeline.register()
    words = ["run", "--archive", str(pipeline.root)]
    for a in pipeline.assignments:
        words += ["--set", a]
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    assert process.stdout is not None
    for line in process.stdout:
        if "in the kernel" in line:
            break
    else:
        raise AssertionError("the run ended by itself")
    process.send_signal(signal.SIGINT)
    for line in process.stdout:
        if "Ctrl-C once more ends at once" in line:
            break
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=30) == 130


WRITING = """
import os, sys, time
real = os.replace
def replace(partial, path):
    if str(path).endswith("written"):
        print("writing", flush=True)
        time.sleep(100)
    real(partial, path)
os.replace = replace
from posegaussian.dags.cli import app
from posegaussian.storage.files.write import write_atomically
@app.app.command()
def write(path: str):
    write_atomically(path, b"whole")
app.main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_interrupted_says_so_and_leaves_nothing_half_written(number: int, tmp_path: Path) -> None:
    (tmp_path / "written").write_bytes(b"old")
    process = subprocess.Popen(
        [sys.executable, "-c", WRITING, "write", str(tmp_path / "written")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
        preexec_fn=_hears_ctrl_c,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "writing\n"
    assert len(list(tmp_path.iterdir())) == 2
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (
        130,
        "",
        "interrupted; what is done is kept, the next run goes on from here\n",
    )
    assert [f.read_bytes() for f in tmp_path.iterdir()] == [b"old"]


def _hears_ctrl_c() -> None:
    """The tests may run where Ctrl-C is ignored, as behind `&` in a script."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.parametrize(
    "words",
    [("plan",), ("export", "walk", "--sheet", "a.png"), ("evaluate",), ("tradeoff", "--knob", "depth.method")],
    ids=lambda words: words[0],
)
def test_every_command_says_that_it_was_interrupted(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Session, "open", lambda *a, **k: os.kill(os.getpid(), signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        done = CliRunner().invoke(app, words)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.exit_code == 130
    assert (done.stdout, done.stderr) == ("", "interrupted; what is done is kept, the next run goes on from here\n")


DROPPING = """
import gc, os, signal, sys, time
from posegaussian.dags.runtime.signals import interruptible
def say(line):
    sys.stdout.write(line + "\\n")  # one write: two threads speak
def within_a_collection(phase, info):
    if phase == "stop":
        gc.callbacks.remove(within_a_collection)
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(10))  # the handler runs here, and Python drops what it raises
gc.callbacks.append(within_a_collection)
try:
    with interruptible(say, lambda: say("killed")):
        gc.collect()
        time.sleep(20)
    say("not heard")
except KeyboardInterrupt:
    say("heard")
"""


def test_a_ctrl_c_that_meets_a_collection_of_garbage_is_heard() -> None:
    done = subprocess.run(
        [sys.executable, "-c", DROPPING],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
    )
    assert sorted(done.stdout.splitlines()) == [
        "heard",
        "stopping; what is finished is kept. Ctrl-C once more ends at once",
    ]
    assert not done.stderr


def test_work_that_must_not_be_torn_apart_is_told_instead_of_interrupted() -> None:
    said: list[str] = []
    stopped = threading.Event()
    with interruptible(said.append, lambda: said.append("killed"), stopped.set):
        os.kill(os.getpid(), signal.SIGINT)
        assert stopped.wait(5.0), "nothing is raised here"
    assert said == ["stopping; what is finished is kept. Ctrl-C once more ends at once"]
