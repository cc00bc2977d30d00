"""Commands end with the next useful one, which can be pasted as it stands."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.config import first_look as looks
from posegaussian.dags.config.first_look import FRAMES
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.regret import regret
from posegaussian.dags.session.session import Session
from tests.support.pipeline import NAME, Pipeline, film


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


def test_a_large_capture_is_looked_at_in_small_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    film(tmp_path / "walk", views=2, frames=FRAMES + 1, held_out=0, size=48)
    monkeypatch.setattr(looks, "SIZE", 24)

    def told(*settings: str) -> list[str]:
        options = [word for s in settings for word in ("--set", s)]
        return CliRunner().invoke(app, ["import", "auto", "walk", *options]).output.splitlines()[-2:]

    look, running = told()
    small = "--set frames.range=0:24 --set frames.size=24"
    assert look == f"then, a first look in minutes: posegaussian export walk --page walk.html {small}"
    assert running == "then: posegaussian run --sequence walk"
    look, _ = told("frames.size=32")
    assert look.endswith("--set frames.size=32 --set frames.range=0:24"), "what the user set stays"
    assert "first look" not in told("frames.size=32", "frames.range=0:4")[0]


def test_looking_at_an_archive_leads_on(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = finished.copy(tmp_path / "archive")
    monkeypatch.chdir(tmp_path)

    def following(*words: str) -> list[str]:
        done = CliRunner().invoke(app, [*words, *archive.options])
        assert done.exit_code == 0, done.output
        lead, _, command = done.output.splitlines()[-1].partition(": posegaussian ")
        assert lead == "next"
        return shlex.split(command)

    page = ["export", NAME, *archive.options, "--page", f"{NAME}.html"]
    video = ["export", NAME, *archive.options, "--video", f"{NAME}.mp4", "--sheet", f"{NAME}.png"]
    report = ["report", *archive.options, "--page", "report.html"]
    assert following("export", NAME, "--sheet", "a.png") == page
    assert following(*page[:2], *page[-2:]) == video
    assert following("export", NAME, "--sheet", "a.png", "--page", "a.html") == report
    assert following("status") == report
    assert following("why", NAME, "depth") == ["status", *archive.options]
    assert following("verify") == ["status", *archive.options]
    assert following("gc", "--kind", "strays") == ["status", *archive.options]
    assert following("reshard", NAME, "--frames", "3") == ["status", "--sequence", NAME, *archive.options]
    changed = ("--set", "rendering.sources=1")
    assert following("status", *changed)[0] == "run"
    assert following("why", NAME, "rendering", *changed)[:3] == ["run", "--sequence", NAME]
    assert following("gc", "--kind", "arrays", "--set", "run.keep=as_declared")[-1] == "--apply"


@pytest.mark.parametrize("command", ["run", "plan", "status"])
def test_an_archive_without_a_sequence_says_how_it_gets_one(command: str, tmp_path: Path) -> None:
    nowhere = CliRunner().invoke(app, [command, "--archive", str(tmp_path / "nowhere")])
    empty = CliRunner().invoke(app, [command, "--archive", str(tmp_path)])
    for done in (nowhere, empty):
        assert "`posegaussian import auto FOLDER`" in str(done.exception)
        assert "simulate plain`" in str(done.exception)


def test_inspect_without_a_name_says_which_there_are(capture: Path) -> None:
    for name in ("walk", "run"):
        CliRunner().invoke(app, ["import", "auto", str(capture), "--sequence", name, "--archive", "an archive"])
    asked = CliRunner().invoke(app, ["inspect", "--archive", "an archive"])
    assert asked.exit_code != 0
    assert "has run, walk: name one" in str(asked.exception)


def test_an_interrupted_run_ends_with_the_command_that_goes_on(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = finished.copy(tmp_path / "archive")
    monkeypatch.setattr(Session, "run_and_report", lambda *_, **__: 130)
    words = ["run", "--sequence", "per*", "--only", "depth", "--path", "still cam00", *archive.options]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 130, done.output
    assert done.output.splitlines()[-1] == next_command(*words)
    assert "next:" not in CliRunner().invoke(app, [*words, "--quiet"]).output


def test_where_nothing_failed_the_status_comes_next(finished: Pipeline) -> None:
    done = CliRunner().invoke(app, ["status", "--failed", *finished.options])
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[-1] == next_command("status", *finished.options)


def test_after_the_regret_of_effects_their_reasons_come_next(
    finished: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(regret, "measured", lambda *_: None)
    monkeypatch.setattr(regret, "as_lines", lambda _: ["a table"])
    done = CliRunner().invoke(app, ["effects", "--regret", NAME, *finished.options])
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[-1] == next_command("plan", "--sequence", NAME, "-v", *finished.options)
