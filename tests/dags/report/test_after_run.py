"""A run leaves the page of its archive behind; whatever becomes of the page, the run ends as it would without."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.humanize.text import Voice
from posegaussian.dags.planning.plan import State
from posegaussian.dags.report import after_run, report
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline

LONG, SHORT = 3600.0, 1.0
"""Seconds of runs that a page of one sequence is little and much beside."""


def told(pipeline: Pipeline, seconds: float, voice: Voice = Voice.NORMAL) -> str:
    out = io.StringIO()
    options = ("--archive", str(pipeline.root))
    console = Console(file=out, width=400)
    after_run.tell(Session(pipeline.configuration, str(pipeline.root), console, voice=voice, options=options), seconds)
    return out.getvalue()


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def test_the_command_writes_the_page_it_is_told_of_where_something_ran(archive: Pipeline, tmp_path: Path) -> None:
    file = tmp_path / "mine.html"
    words = ["run", *archive.options, "--set", f"run.report={file}"]
    fresh = CliRunner().invoke(app, words)
    assert (fresh.exit_code, file.exists()) == (0, False), "nothing ran"
    done = CliRunner().invoke(app, [*words, "--set", "metrics.measures=[psnr]"])
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith(f"report: 1 sequence in {file}")]
    assert lines[-1].startswith("next: "), "what to type next stays last"
    assert at < len(lines) - 1
    assert "metrics.measures" in file.read_text(encoding="utf-8"), "under the run's own settings"


def test_auto_writes_beside_the_sequences_after_runs_that_took_far_longer(archive: Pipeline) -> None:
    file = archive.root / after_run.NAME
    assert (told(archive, SHORT), file.exists()) == ("", False)
    assert f"1 sequence in {file}" in told(archive, LONG)
    page = file.read_bytes()
    assert NAME.encode() in page
    assert "is older than this run; to write it: posegaussian report --archive" in told(archive, SHORT)
    assert file.read_bytes() == page
    assert archive.session.names([]) == [NAME]
    assert CliRunner().invoke(app, ["verify", *archive.options]).exit_code == 0


def test_off_writes_nothing_and_quiet_writes_in_silence(archive: Pipeline) -> None:
    file = archive.root / after_run.NAME
    assert (told(archive.with_settings("run.report=off"), LONG), file.exists()) == ("", False)
    assert (told(archive, LONG, Voice.QUIET), file.exists()) == ("", True)


def test_a_page_that_cannot_be_made_is_a_sentence(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    (archive.root / after_run.NAME).mkdir()
    assert "report.html was not written: " in told(archive, LONG)
    monkeypatch.setattr(report, "accounts", lambda *_: 1 / 0)
    said = told(archive, LONG, Voice.QUIET)
    assert "was not written: division by zero; to write it: posegaussian report" in said


def test_where_the_page_lies_changes_no_result(archive: Pipeline) -> None:
    plan = archive.with_settings("run.report=off").plan()
    assert all(v.state is State.FRESH for v in plan.verdicts.values())


def test_a_place_that_cannot_be_written_to_is_refused_before_anything_runs(archive: Pipeline, tmp_path: Path) -> None:
    for wanted, why in ((tmp_path / "nowhere" / "a.html", "does not exist"), ("a.pdf", "an .html file is expected")):
        done = CliRunner().invoke(app, ["run", *archive.options, "--set", f"run.report={wanted}"])
        assert isinstance(done.exception, ConfigError)
        assert why in str(done.exception)
