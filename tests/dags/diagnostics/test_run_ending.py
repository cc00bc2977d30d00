"""A run ends with where its results are and what to type next;
its retry and its status know the paths it was asked for."""

from __future__ import annotations

import io
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics.run_log import retry_command
from posegaussian.dags.diagnostics.status import standing
from posegaussian.dags.humanize.text import Voice
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from tests.support.pipeline import NAME, Pipeline

STILL = "still cam00"


@pytest.fixture
def asked(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """Settings whose own path was never rendered, and a run that was asked for another one."""
    return finished.copy(tmp_path / "archive").with_settings("rendering.paths=[orbit]")


def run(pipeline: Pipeline, *paths: str, voice: Voice = Voice.NORMAL) -> tuple[str, Session]:
    out = io.StringIO()
    session = Session(
        pipeline.configuration,
        str(pipeline.root),
        Console(file=out, width=200),
        voice=voice,
        options=("--archive", str(pipeline.root)),
    )
    plan = session.plan(NAME, Selection(), paths)
    assert session.run_and_report([plan], Selection(), say_next=True) == 0
    return out.getvalue(), session


def test_the_end_says_where_results_are_and_what_to_type(asked: Pipeline) -> None:
    said, _ = run(asked, STILL)
    (place,) = [line for line in said.splitlines() if "pictures of 'still cam00' in " in line]
    assert Path(place.rpartition(" in ")[2]).is_dir()
    (command,) = [line.removeprefix("next: ") for line in said.splitlines() if line.startswith("next: ")]
    words = shlex.split(command)
    assert words[:3] == ["posegaussian", "export", NAME]
    assert words[words.index("--path") + 1] == STILL
    assert "all fresh" in run(asked, STILL)[0]
    assert command in run(asked, STILL)[0], "also where there was nothing to do"


def test_pictures_that_only_left_out_are_not_spoken_of(asked: Pipeline) -> None:
    out = io.StringIO()
    session = Session(asked.configuration, str(asked.root), Console(file=out, width=200))
    selection = Selection(only=frozenset({"smoothing"}))
    plan = session.plan(NAME, selection, (STILL,))
    assert session.run_and_report([plan], selection, say_next=True) == 0
    assert "left out by --only" in out.getvalue()
    assert "pictures of" not in out.getvalue()
    run(asked, STILL)
    again = session.plan(NAME, selection, (STILL,))
    session.run_and_report([again], selection, say_next=True)
    assert "pictures of 'still cam00' in " in out.getvalue(), "they are there now"


def test_quiet_says_the_result_alone(asked: Pipeline) -> None:
    said, _ = run(asked, STILL, voice=Voice.QUIET)
    assert said.splitlines()[-1].endswith(" s")
    assert " done, " in said
    assert "next: " not in said
    assert "not needed" not in said


def test_reasons_are_told_where_they_are_asked_for(asked: Pipeline) -> None:
    assert "not needed" not in run(asked, STILL)[0]
    assert "not needed" in run(asked.with_settings("pose.sigma=0.05"), STILL, voice=Voice.VERBOSE)[0]


def test_status_counts_the_path_that_was_rendered(asked: Pipeline) -> None:
    assert asked.plan().counts("rendering")[State.FRESH] == 0
    run(asked, STILL)
    after = standing(asked.session, NAME)["rendering"]
    assert after["done"] == after["all"] > 0
    asked.run()
    configured = asked.plan().counts("rendering")
    assert standing(asked.session, NAME)["rendering"]["all"] == configured.total(), (
        "once the configured path is there, it counts"
    )


def test_a_retry_asks_for_the_same_path(asked: Pipeline) -> None:
    _, session = run(asked, STILL)
    (folder,) = sorted((asked.root / "_runs").iterdir())[-1:]
    words = shlex.split(retry_command(session.archive, [NAME], folder.name))
    settings = load_configuration(Path(words[words.index("--config") + 1])).for_sequence(NAME)
    assert list(settings.rendering.paths) == [STILL]


def test_a_path_that_was_asked_for_wins_over_a_sequences_own(tmp_path: Path) -> None:
    (tmp_path / "pipeline.yaml").write_text("sequences: {walk: {rendering: {paths: [orbit]}, depth: {method: hull}}}\n")
    configuration = load_configuration(tmp_path / "pipeline.yaml")
    (tmp_path / "kept.yaml").write_text(configuration.as_yaml([STILL]))
    again = load_configuration(tmp_path / "kept.yaml").for_sequence("walk")
    assert (list(again.rendering.paths), again.depth.method) == ([STILL], "hull")
