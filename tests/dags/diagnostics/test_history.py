"""What failed stays known until it is finished, with its sentence and the command that retries it."""

from __future__ import annotations

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
    (one,) = still_failed(archive, [NAME])
    assert (one.task.stage, one.task.partition) == ("depth", 1)
    assert "cosmic ray" in one.error
    assert one.blocked == 4, (
        "gaussians, rendering and metrics of the partition, and metrics of the next one, which looks a frame back"
    )
    assert still_failed(archive, ["another"]) == []
    shown = CliRunner().invoke(app, ["status", "--failed", "--archive", str(failed.root), *COMMON])
    assert shown.exit_code == 1
    assert "depth p0001" in shown.output
    assert "posegaussian run --archive" in shown.output
    (row,) = [r for r in ledger.read(archive) if r["state"] == "failed"]
    assert (row["stage"], row["partition"], row["mended"], row["seconds"]) == ("depth", 1, False, None)
    assert "cosmic ray" in row["error"]

    assert failed.session.run_and_report([failed.plan()], Selection()) == 0
    assert still_failed(archive, [NAME]) == []
    assert [r["mended"] for r in ledger.read(archive) if r["state"] == "failed"] == [True]
    assert (
        "nothing failed"
        in CliRunner().invoke(app, ["status", "--failed", "--archive", str(failed.root), *COMMON]).output
    )


def test_the_retry_command_does_what_failed_under_the_settings_of_that_run(failed: Pipeline) -> None:
    (one,) = still_failed(Archive(failed.root), [NAME])
    (line,) = retries(Archive(failed.root), [one])
    words = shlex.split(line.removeprefix("retry with: "))
    assert words[:2] == ["posegaussian", "run"]
    done = CliRunner().invoke(app, [*words[1:], "--scheduler", "serial"])
    assert done.exit_code == 0, done.output
    assert failed.plan().all_fresh


def test_a_mended_failure_whose_log_is_gone_is_known_by_its_receipt(failed: Pipeline) -> None:
    failed.run()  # without a log
    assert still_failed(Archive(failed.root), [NAME]) == []


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
