"""What is tried again, how often, and what is said in the end; one broken sequence among many."""

from __future__ import annotations

import errno
import io
from pathlib import Path

import pytest
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed, TaskRetried
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.failures import Kind, TaskTimedOut, classify
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import LeaseHeld, LeaseLost, SourceError
from tests.support.pipeline import FORCED, Pipeline, film

GAUSSIANS = Selection(only=frozenset({"gaussians"}), force=frozenset({"gaussians"}))


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (ValueError("depth is NaN"), Kind.DETERMINISTIC),
        (SourceError("changed since it was imported"), Kind.DETERMINISTIC),
        (FileNotFoundError(errno.ENOENT, "no such file"), Kind.DETERMINISTIC),
        (PermissionError(errno.EACCES, "denied"), Kind.DETERMINISTIC),
        (OSError(errno.ENOSPC, "no space left"), Kind.DETERMINISTIC),
        (OSError(errno.EIO, "input/output error"), Kind.TRANSIENT),
        (OSError(errno.ESTALE, "stale file handle"), Kind.TRANSIENT),
        (ConnectionResetError("peer"), Kind.TRANSIENT),
        (
            RuntimeError("CUDA error: unknown error\nCUDA kernel errors might be reported asynchronously"),
            Kind.TRANSIENT,
        ),
        (RuntimeError("CUDA out of memory. Tried to allocate 2 GiB"), Kind.MEMORY),
        (MemoryError(), Kind.MEMORY),
        (TaskTimedOut("it took longer than 3 s (run.timeout)"), Kind.TIMEOUT),
        (LeaseLost("taken over"), Kind.LOST),
        (LeaseHeld("held by run x"), Kind.HELD),
    ],
)
def test_errors_have_a_class(error: Exception, kind: Kind) -> None:
    assert classify(error) is kind


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def run(pipeline: Pipeline, rules: Rules, selection: Selection = GAUSSIANS) -> list[Event]:
    events: list[Event] = []
    Run([pipeline.plan(selection=selection)], selection, SerialBackend(), [events.append], rules=rules).go()
    return events


def stumble(monkeypatch: pytest.MonkeyPatch, errors: list[Exception]) -> None:
    """Partition 1 of gaussians meets these errors, one an attempt, and then works."""
    import posegaussian.stages.gaussians.run as gaussians

    real = gaussians.run

    def stumbling(inputs: object, params: object) -> object:
        if inputs.partition.start == 2 and errors:  # type: ignore[attr-defined]
            raise errors.pop(0)
        return real(inputs, params)  # type: ignore[arg-type]

    monkeypatch.setattr(gaussians, "run", stumbling)


def of(events: list[Event], kind: type) -> list:
    return [e for e in events if isinstance(e, kind)]


def test_a_transient_failure_is_tried_again_with_a_growing_pause(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    stumble(monkeypatch, [OSError(errno.EIO, "disk"), ConnectionResetError("peer")])
    events = run(archive, Rules(retries=2, backoff=0.05))
    assert [(e.kind, e.pause) for e in of(events, TaskRetried)] == [("transient", 0.05), ("transient", 0.1)]
    assert len(of(events, TaskDone)) == 3


def test_a_failure_that_stays_transient_fails_after_its_retries_and_says_so(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    stumble(monkeypatch, [OSError(errno.EIO, "disk")] * 9)
    events = run(archive, Rules(retries=1, backoff=0.01))
    (failed,) = of(events, TaskFailed)
    assert failed.kind == "transient"
    assert "it was tried 2 times" in failed.error
    assert len(of(events, TaskDone)) == 2


def test_a_deterministic_failure_is_not_tried_again(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    stumble(monkeypatch, [ValueError("depth is NaN")] * 9)
    events = run(archive, Rules(retries=5, backoff=0.01))
    assert not of(events, TaskRetried)
    assert [f.kind for f in of(events, TaskFailed)] == ["deterministic"]


def test_what_ran_out_of_memory_is_tried_once_more_and_then_fails_with_advice(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    stumble(monkeypatch, [MemoryError()] * 9)
    events = run(archive, Rules(retries=5))
    assert [e.kind for e in of(events, TaskRetried)] == ["memory or crash"]
    (failed,) = of(events, TaskFailed)
    assert "tried once more alone" in failed.error
    assert "run.workers" in failed.error


def three_sequences(tmp_path: Path) -> tuple[Path, list[str]]:
    """An archive of three short captures; returns its folder and the settings."""
    settings = [
        "run.scheduler=serial",
        "views.held_out=[]",
        "partition.frames=1",
        *(f"effects.{e}={state}" for e, state in FORCED.items()),
    ]
    root = tmp_path / "archive"
    configuration = load_configuration(None, settings, folder=tmp_path)
    for name in ("a", "b", "c"):
        film(tmp_path / name, views=2, frames=2, held_out=0, joints=False)
        register(
            Archive.open(str(root), create=True),
            name,
            find_capture("images", tmp_path / name, [], configuration.for_sequence(name)),
            configuration.for_sequence(name),
        )
    return root, settings


def report(root: Path, settings: list[str]) -> tuple[int, str]:
    console = Console(file=io.StringIO(), width=300)
    session = Session(load_configuration(None, settings, folder=root), str(root), console)
    plans, refused = session.usable(session.names(()), (), Selection())
    status = session.run_and_report(plans, Selection(), refused)
    return status, console.file.getvalue()  # type: ignore[attr-defined]


def test_one_broken_sequence_among_three_is_explained_and_mended_alone(tmp_path: Path) -> None:
    root, settings = three_sequences(tmp_path)
    source = sorted((tmp_path / "b/images/cam00").iterdir())[1]
    whole = source.read_bytes()
    source.write_bytes(whole[:-9])
    status, said = report(root, settings)
    assert status == 1
    table = said[said.index("what failed") :]
    assert "frames cam00 p0001" in table
    assert "changed since it was imported" in table
    assert "deterministic" in table
    assert "retry with: posegaussian run --archive" in said
    assert said.rstrip().splitlines()[-1].startswith(tuple("123456789"))
    assert "--sequence b" in said.partition("retry with")[2]
    for name in ("a", "c"):
        assert len(list((root / name / "_receipts").rglob("*.json"))) > len(
            list((root / "b" / "_receipts").rglob("*.json"))
        )
    source.write_bytes(whole)
    before = {p: p.stat().st_mtime_ns for p in root.rglob("*.json") if "_receipts" in p.parts}
    status, said = report(root, settings)
    assert status == 0, said
    after = {p: p.stat().st_mtime_ns for p in root.rglob("*.json") if "_receipts" in p.parts}
    assert {p: after[p] for p in before} == before, "what was done stays as it is"
    assert {p.relative_to(root).parts[0] for p in after.keys() - before.keys()} == {"b"}


def test_a_sequence_that_cannot_even_be_planned_or_prepared_does_not_stop_the_others(tmp_path: Path) -> None:
    root, settings = three_sequences(tmp_path)
    (root / "a/zarr.json").write_text('{"attributes": {"posegaussian": {"format": 1, "capture": 7}}}')
    (root / "b/frames").write_text("a file where a folder belongs")
    status, said = report(root, settings)
    assert status == 1
    table = said[said.index("what failed") :]
    assert "says that partitions have None frames" in table
    assert "frames cam00 p0000" in table
    assert "--sequence a --sequence b" in said or "--sequence b --sequence a" in said
    for file in (root / "c/_receipts").rglob("*.json"):
        assert file.stat().st_size
    assert len(list((root / "c/_receipts").rglob("*.json"))) == 10
    assert "10 done, 0 fresh, 1 failed, 9 blocked" in said


def test_what_is_blocked_is_told_once_for_everything_it_waits_for() -> None:
    from posegaussian.dags.diagnostics.progress import WarningCollector
    from posegaussian.dags.planning.tasks import Task
    from posegaussian.dags.runtime.events import TaskBlocked

    cause, left = Task("b", "survey", None, 1), Task("b", "pose", 0)
    collector = WarningCollector()
    collector(TaskFailed(cause, "no light", "", "deterministic"))
    for task in (Task("b", "frames", 0, 0), Task("b", "frames", 0, 1), Task("b", "depth", 0)):
        collector(TaskBlocked(task, cause))
    collector(TaskBlocked(Task("b", "smoothing", 0), left))
    assert collector.blocked_sentences({"b": ("cam00", "cam01")}) == [
        "blocked: b: 3 tasks of frames, depth: survey cam01 failed",
        "blocked: b: 1 task of smoothing: pose p0000 is stale and left out by --only: add --only pose",
    ]
