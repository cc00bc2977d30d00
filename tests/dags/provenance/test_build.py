"""The digest of what computes: code and libraries by name; what was edited while a process runs is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.provenance import builds, code_digest
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.failures import Kind
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.storage.model.errors import OtherCode
from tests.support.pipeline import Pipeline, ended


def edited(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """As if a file had been edited just now; modules that were imported already count as not looked at yet."""
    file, real = code_digest.ROOT / name, code_digest.stamp_of
    monkeypatch.setattr(code_digest, "stamp_of", lambda f: (1, 1) if f == file else real(f))
    monkeypatch.setattr(builds, "_checked", set())
    monkeypatch.setattr(builds, "_loaded", 0)


def test_the_build_names_every_kernel_the_executor_the_store_the_weights_and_the_libraries() -> None:
    versions = builds.here().versions
    assert {
        "dags/runtime/worker.py",
        "dags/runtime/executors/dask_worker.py",
        "storage/archive/shards.py",
        "stages/contract/declaration.py",
        "stages/depth/run.py",
        "stages/network/shipped/fast.safetensors",
        "numpy",
        "zarr",
        "torch",
        "python",
    } <= versions.keys()
    assert "dags/cli/app.py" not in versions, "it touches no byte of a result"
    assert builds.here() is builds.here(), "taken once a process"


def test_differences_are_named_libraries_first_and_long_lists_are_cut() -> None:
    own = builds.here().versions
    there = {**own, "numpy": "1.0", "stages/depth/run.py": "x"}
    del there["storage/archive/shards.py"]
    assert (
        builds.differences(there)
        == f"numpy (1.0 there, {own['numpy']} here), stages/depth/run.py (x there, {own['stages/depth/run.py']} here),"
        " storage/archive/shards.py is missing there"
    )
    assert builds.differences({}).endswith(f" and {len(own) - builds.NAMED} more")


def test_a_process_refuses_a_digest_that_is_not_its_own() -> None:
    builds.refuse_other(builds.here().digest, "tcp://w")
    with pytest.raises(OtherCode) as refused:
        builds.refuse_other("f" * 32, "tcp://w")
    assert (refused.value.worker, refused.value.versions) == ("tcp://w", builds.here().versions)


def test_a_library_that_was_exchanged_under_a_running_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = {**builds.libraries(), "numpy": "99.0"}
    monkeypatch.setattr(builds, "libraries", lambda: other)
    monkeypatch.setattr(builds, "_loaded", 0)
    with pytest.raises(OtherCode, match=r"numpy 99\.0 is installed, but process \d+ on .* in memory; start it again"):
        builds.check_imports()


def test_a_kernel_that_was_edited_after_the_run_began_computes_nothing_that_counts(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert [
        (type(e), e.kind if isinstance(e, TaskFailed) else "") for e in events if isinstance(e, TaskDone | TaskFailed)
    ] == [(TaskDone, ""), *[(TaskFailed, Kind.UNFIT.value)] * 2]
    assert "stages/metrics/run.py was edited since process" in failed[0].error
    assert failed[0].error.endswith("start it again")
    monkeypatch.undo()
    after = archive.plan().book.receipts
    assert all(after[e.task].facts["token"] == before[e.task].facts["token"] for e in failed), (
        "what was there before stays"
    )


def test_a_process_whose_files_were_edited_begins_no_run(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = finished.copy(tmp_path / "archive")
    plan = archive.plan(selection=Selection(force=frozenset({"metrics"})))
    edited(monkeypatch, "storage/archive/shards.py")
    builds.here.cache_clear()
    events: list[Event] = []
    with pytest.raises(OtherCode, match=r"storage/archive/shards\.py was edited since process"):
        Run([plan], Selection(force=frozenset({"metrics"})), SerialBackend(), [events.append]).go()
    assert not events


def test_the_run_goes_on_with_what_it_imported_when_that_is_edited(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = finished.copy(tmp_path / "archive")
    builds.here()
    builds.check_imports()
    file, real = code_digest.ROOT / "storage/archive/shards.py", code_digest.stamp_of
    monkeypatch.setattr(code_digest, "stamp_of", lambda f: (1, 1) if f == file else real(f))
    events = archive.run(selection=Selection(force=frozenset({"metrics"})))
    assert ended(events).failed == 0
    monkeypatch.undo()
    assert archive.plan().all_fresh
