"""The digest of what computes: code and libraries by name; what was edited while a process runs is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from dags import build, code
from dags.events import Event, TaskDone, TaskFailed
from dags.failures import Kind
from dags.run import Run
from dags.selection import Selection
from dags.serial import SerialBackend
from storage.errors import OtherCode
from tests.pipeline import Pipeline, ended


def edited(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """As if a file had been edited just now; modules that were imported already count as not looked at yet."""
    file, real = code.ROOT / name, code.stamp_of
    monkeypatch.setattr(code, "stamp_of", lambda f: (1, 1) if f == file else real(f))
    monkeypatch.setattr(build, "_checked", set())
    monkeypatch.setattr(build, "_loaded", 0)


def test_the_build_names_every_kernel_the_executor_the_store_the_weights_and_the_libraries() -> None:
    versions = build.here().versions
    assert {"dags/execute.py", "dags/on_worker.py", "storage/shards.py", "stages/contract.py", "stages/depth/run.py", "stages/network/shipped/fast.safetensors", "numpy", "zarr", "torch", "python"} <= versions.keys()
    assert "dags/cli.py" not in versions, "it touches no byte of a result"
    assert build.here() is build.here(), "taken once a process"


def test_differences_are_named_libraries_first_and_long_lists_are_cut() -> None:
    own = build.here().versions
    there = {**own, "numpy": "1.0", "stages/depth/run.py": "x"}
    del there["storage/shards.py"]
    assert build.differences(there) == f"numpy (1.0 there, {own['numpy']} here), stages/depth/run.py (x there, {own['stages/depth/run.py']} here), storage/shards.py is missing there"
    assert build.differences({}).endswith(f" and {len(own) - build.NAMED} more")


def test_a_process_refuses_a_digest_that_is_not_its_own() -> None:
    build.refuse_other(build.here().digest, "tcp://w")
    with pytest.raises(OtherCode) as refused:
        build.refuse_other("f" * 32, "tcp://w")
    assert (refused.value.worker, refused.value.versions) == ("tcp://w", build.here().versions)


def test_a_library_that_was_exchanged_under_a_running_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = {**build.libraries(), "numpy": "99.0"}
    monkeypatch.setattr(build, "libraries", lambda: other)
    monkeypatch.setattr(build, "_loaded", 0)
    with pytest.raises(OtherCode, match=r"numpy 99\.0 is installed, but process \d+ on .* in memory; start it again"):
        build.check_imports()


def test_a_kernel_that_was_edited_after_the_run_began_computes_nothing_that_counts(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = finished.copy(tmp_path / "archive")
    before = archive.plan().book.receipts
    selection = Selection(only=frozenset({"metrics"}), force=frozenset({"metrics"}))
    events: list[Event] = []

    def tell(event: Event) -> None:
        events.append(event)
        if isinstance(event, TaskDone):
            edited(monkeypatch, "stages/metrics/run.py")

    Run([archive.plan(selection=selection)], selection, SerialBackend(), [tell]).go()
    failed = [e for e in events if isinstance(e, TaskFailed)]
    assert [(type(e), e.kind if isinstance(e, TaskFailed) else "") for e in events if isinstance(e, TaskDone | TaskFailed)] == [(TaskDone, ""), *[(TaskFailed, Kind.UNFIT.value)] * 2]
    assert "stages/metrics/run.py was edited since process" in failed[0].error
    assert failed[0].error.endswith("start it again")
    monkeypatch.undo()
    after = archive.plan().book.receipts
    assert all(after[e.task].facts["token"] == before[e.task].facts["token"] for e in failed), "what was there before stays"


def test_a_process_whose_files_were_edited_begins_no_run(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = finished.copy(tmp_path / "archive")
    plan = archive.plan(selection=Selection(force=frozenset({"metrics"})))
    edited(monkeypatch, "storage/shards.py")
    build.here.cache_clear()
    events: list[Event] = []
    with pytest.raises(OtherCode, match=r"storage/shards\.py was edited since process"):
        Run([plan], Selection(force=frozenset({"metrics"})), SerialBackend(), [events.append]).go()
    assert not events


def test_the_run_goes_on_with_what_it_imported_when_that_is_edited(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = finished.copy(tmp_path / "archive")
    build.here()
    build.check_imports()
    file, real = code.ROOT / "storage/shards.py", code.stamp_of
    monkeypatch.setattr(code, "stamp_of", lambda f: (1, 1) if f == file else real(f))
    events = archive.run(selection=Selection(force=frozenset({"metrics"})))
    assert ended(events).failed == 0
    monkeypatch.undo()
    assert archive.plan().all_fresh
