"""A command with other settings than the last run's says so before it makes anything anew."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics import other_settings
from posegaussian.dags.diagnostics.other_settings import made_otherwise
from posegaussian.dags.planning.selection import Selection
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline

OWN = "pose.sigma=0.07"


@pytest.fixture(scope="module")
def logged(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """The archive after a run whose settings are kept. Read it, do not change it."""
    copy = finished.copy(tmp_path_factory.mktemp("logged") / "archive")
    session = copy.with_settings(OWN, "run.report=off").session
    assert session.run_and_report([session.plan(NAME, Selection())], Selection()) == 0
    return copy


def said(pipeline: Pipeline) -> list[str]:
    return made_otherwise(Archive.open(str(pipeline.root)), pipeline.plan())


def test_what_differs_is_named_and_the_option_given_asks_for_what_the_last_run_made(logged: Pipeline) -> None:
    (sentence,) = said(logged)
    assert re.search(r"pose: sigma: 0\.07 -> 0\.\d+;", sentence), sentence
    assert "run.report" not in sentence, "no result depends on it"
    option, file = shlex.split(sentence)[-2:]
    assert option == "--config"
    session = replace(logged.session, configuration=load_configuration(Path(file)))
    assert session.plan(NAME, Selection()).all_fresh


def test_settings_of_a_run_are_read_once_for_all_that_it_worked_on(
    logged: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []
    monkeypatch.setattr(
        other_settings, "load_configuration", lambda file: read.append(file) or load_configuration(file)
    )
    other_settings._settings.cache_clear()
    assert said(logged) == said(logged) != []
    assert len(read) == 1


def test_nothing_is_said_where_nothing_is_made_anew(logged: Pipeline) -> None:
    assert said(logged.with_settings(OWN)) == []


def test_nothing_is_said_of_equal_settings_whatever_is_missing(logged: Pipeline) -> None:
    assert said(logged.with_settings(OWN, "run.threads=2", 'rendering.paths=["still mid00"]')) == []


def test_without_a_run_that_kept_its_settings_nothing_is_known(finished: Pipeline) -> None:
    assert not finished.with_settings(OWN).plan().all_fresh
    assert said(finished.with_settings(OWN)) == []


def test_settings_that_this_version_does_not_know_are_passed_over(logged: Pipeline, tmp_path: Path) -> None:
    copy = logged.copy(tmp_path / "archive")
    for file in copy.root.glob("_runs/*/pipeline.yaml"):
        file.write_text("nothing_of_ours: 1\n")
    assert said(copy) == []
