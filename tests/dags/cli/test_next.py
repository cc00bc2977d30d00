"""Commands end with the next useful one, which can be pasted as it stands."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.humanize.text import next_command
from tests.support.pipeline import film


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    film(tmp_path / "a capture", views=3, frames=2, held_out=0, size=48)
    return tmp_path / "a capture"


def test_words_are_quoted_for_a_shell() -> None:
    assert next_command("run", "--archive", "a b") == "next: posegaussian run --archive 'a b'"


def test_the_way_from_an_import_to_a_run(capture: Path) -> None:
    archive = ("--archive", "an archive")
    done = CliRunner().invoke(app, ["import", "auto", str(capture), "--sequence", "walk", *archive])
    inspecting, running = done.output.splitlines()[-2:]
    assert inspecting == "next: posegaussian inspect walk --archive 'an archive'"
    assert running == "then: posegaussian run --sequence walk --archive 'an archive'"
    planned = CliRunner().invoke(app, ["plan", "--only", "frames", *archive, "--sequence", "w*"])
    assert planned.exit_code == 0, planned.output
    last = planned.output.splitlines()[-1]
    assert last == "next: posegaussian run --sequence 'w*' --only frames --archive 'an archive'"
    ran = CliRunner().invoke(app, ["plan", *shlex.split(last)[3:]])
    assert ran.output.splitlines()[-1] == last


@pytest.mark.parametrize("command", ["run", "plan", "status"])
def test_an_archive_without_a_sequence_says_how_it_gets_one(command: str, tmp_path: Path) -> None:
    nowhere = CliRunner().invoke(app, [command, "--archive", str(tmp_path / "nowhere")])
    empty = CliRunner().invoke(app, [command, "--archive", str(tmp_path)])
    for done in (nowhere, empty):
        assert "`posegaussian import auto FOLDER`" in str(done.exception)
        assert "simulate plain`" in str(done.exception)
