"""What failed stays known until it is finished, with its sentence and the command that retries it."""

from __future__ import annotations

import importlib
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.diagnostics.run_log import retries, retry_command, still_failed
from posegaussian.dags.planning.selection import Selection
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline

COMMON = [
    "--set",
    "views.held_out=[mid00]",
    "--set",
    "effects.temporal_smoothing=on",
    "--set",
    "effects.exposure_matching=off",
]


@pytest.fixture
def failed(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Pipeline:
    """An archive whose last run failed in one partition of depth."""
    import posegaussian.stages.depth.run as depth

    archive, real = finished.copy(tmp_path / "archive"), depth.run

    def failing(inputs: object, params: object) -> object:
        if inputs.partition.start == 2:  # type: ignore[attr-defined]
            raise RuntimeError("the cosmic ray of partition 1")
        return real(inputs, params)  # type: ignore[arg-type]

    monkeypatch.setattr(depth, "run", failing)
    selection = Selection(force=frozenset({"depth"}))
    assert archive.session.run_and_report([archive.plan(selection=selection)], selection) == 1
    monkeypatch.undo()
    return archive


def test_a_failure_is_shown_until_a_run_mends_it(failed: Pipeline) -> None:
    archive = Archive(failed.root)
    (one,) = still_failed(failed.session, [NAME])
    assert (one.task.stage, one.task.partition) == ("depth", 1)
    assert "cosmic ray" in one.error
    assert one.blocked == 4, (
        "gaussians, rendering and metrics of the partition, and metrics of the next one, which looks a frame back"
    )
    assert still_failed(failed.session, ["another"]) == []
    shown = CliRunner().invoke(app, ["status", "--failed", "--archive", str(failed.root), *COMMON])
    assert shown.exit_code == 1
    assert "depth p0001" in shown.output
    assert "posegaussian run --archive" in shown.output
    (row,) = [r for r in ledger.read(archive) if r["state"] == "failed"]
    assert (row["stage"], row["partition"], row["mended"], row["seconds"]) == ("depth", 1, False, None)
    assert "cosmic ray" in row["error"]

    assert failed.session.run_and_report([failed.plan()], Selection()) == 0
    assert still_failed(failed.session, [NAME]) == []
    assert [r["mended"] for r in ledger.read(archive) if r["state"] == "failed"] == [True]
    assert (
        "nothing failed"
        in CliRunner().invoke(app, ["status", "--failed", "--archive", str(failed.root), *COMMON]).output
    )


def test_the_retry_command_does_what_failed_under_the_settings_of_that_run(failed: Pipeline) -> None:
    (one,) = still_failed(failed.session, [NAME])
    (line,) = retries(Archive(failed.root), [one])
    words = shlex.split(line.removeprefix("retry with: "))
    assert words[:2] == ["posegaussian", "run"]
    done = CliRunner().invoke(app, [*words[1:], "--scheduler", "serial"])
    assert done.exit_code == 0, done.output
    assert failed.plan().all_fresh


def test_a_mended_failure_whose_log_is_gone_is_known_by_its_receipt(failed: Pipeline) -> None:
    failed.run()  # without a log
    assert still_failed(failed.session, [NAME]) == []


def failing(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    """Every task of a stage, by the folder of its kernel, fails."""

    def fail(inputs: object, params: object) -> object:
        raise RuntimeError("another cosmic ray")

    monkeypatch.setattr(importlib.import_module(f"posegaussian.stages.{stage}.run"), "run", fail)


def test_going_back_to_settings_whose_results_are_there_leaves_nothing_to_retry(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is computed, so no receipt is newer than the failure."""
    good = finished.copy(tmp_path / "archive")
    other = good.with_settings("depth.method=hull")
    with monkeypatch.context() as m:
        failing(m, "depth")
        assert other.session.run_and_report([other.plan()], Selection()) == 1
    count = len(good.context().grid.partitions)
    assert len(still_failed(good.session, [NAME])) == count, "what was there went aside"
    assert good.session.run_and_report([good.plan()], Selection()) == 0
    assert still_failed(good.session, [NAME]) == []
    assert len(still_failed(other.session, [NAME])) == count, "under those settings they are still to be made"
    assert len(still_failed(other.with_settings("frames.range=0:2").session, [NAME])) == 1, "others are not asked for"


def test_a_camera_path_that_was_asked_for_once_is_still_failed(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = finished.copy(tmp_path / "archive")
    with monkeypatch.context() as m:
        failing(m, "peers")
        assert archive.session.run_and_report([archive.plan("still cam01")], Selection()) == 1
    failed = still_failed(archive.session, [NAME])
    assert {f.task.path for f in failed} == set(archive.context("still cam01").paths)


def test_names_with_blanks_survive_a_shell(tmp_path: Path) -> None:
    assert shlex.split(retry_command(Archive(tmp_path / "my archive"), ["a b", "a b", "c"])) == [
        "posegaussian",
        "run",
        "--archive",
        str(tmp_path / "my archive"),
        "--sequence",
        "a b",
        "--sequence",
        "c",
    ]
