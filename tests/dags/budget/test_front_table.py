"""A front that was measured on a sequence is what a budget buys from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from posegaussian.dags.budget import expected
from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.bought import bought
from posegaussian.dags.budget.choice import affordable
from posegaussian.dags.budget.front_table import front_points, measured_under
from posegaussian.dags.budget.probe import Probe
from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.dags.tradeoff.tradeoff import write_parquet
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline

KNOBS = ("frames.size", "network.weights", "refinement.steps")


def row(size: str, weights: str, steps: str, seconds: float, psnr: float, front: bool) -> dict[str, Any]:
    return {
        **dict(zip(KNOBS, (size, weights, steps), strict=True)),
        "depth s/frame": 0.1,
        "total s/frame": seconds,
        "psnr box dB": psnr,
        "ssim box": 0.9,
        "front": front,
    }


@pytest.fixture
def table(finished: Pipeline, tmp_path: Path) -> Path:
    """Three settings, dearest first, and one that another beats, measured with what is set here."""
    rows = [
        row("full", "auto", "50", 9.0, 29.5, True),
        row("full", "none", "20", 4.0, 27.25, True),
        row("24", "none", "0", 1.0, 22.0, True),
        row("24", "auto", "0", 5.0, 21.0, False),
    ]
    under = measured_under(session_of(finished).undecided(NAME, ()), KNOBS)
    write_parquet(tmp_path / "tradeoff.parquet", rows, {"sequence": "walk", **under})
    return tmp_path / "tradeoff.parquet"


def session_of(pipeline: Pipeline, *more: str) -> Session:
    settings = ["run.scheduler=serial", "run.report=off", "views.held_out=[mid00]", *more]
    return Session(load_configuration(None, settings, folder=pipeline.root), str(pipeline.root), Console(quiet=True))


def test_points_are_the_front_as_settings_cheapest_first(table: Path) -> None:
    points = front_points(table, ())
    assert [p.settings for p in points] == [
        {"frames.size": 24, "network.weights": "none", "refinement.steps": 0},
        {"frames.size": None, "network.weights": "none", "refinement.steps": 20},
        {"frames.size": None, "network.weights": "auto", "refinement.steps": 50},
    ]
    assert [p.against for p in points] == [-7.5, -2.25, 0.0]
    assert "27.25 dB on held-out cameras of walk" in points[1].worth
    assert "refinement.steps 20" in points[1].told


@pytest.mark.parametrize(
    ("more", "known"),
    [
        ((), True),
        (("refinement.steps=7", "frames.size=24"), True),  # knobs
        (("frames.range=0:4", "rendering.paths=[orbit]", "metrics.measures=[ssim]", "run.threads=2"), True),
        (("views.held_out=[]",), True),  # nothing to measure by
        (("rendering.sources=1",), False),
        (("effects.hole_filling=off",), False),
        (("views.held_out=[cam00]",), False),
        (("views.sources=uniform 3",), False),
        ((f"sequences={{{NAME}: {{depth: {{pairs: 1}}}}}}",), False),
    ],
)
def test_what_a_front_reached_is_known_where_all_else_is_set_as_it_was_measured(
    finished: Pipeline, table: Path, more: tuple[str, ...], known: bool
) -> None:
    points = front_points(table, [session_of(finished, *more).undecided(NAME, ())])
    assert [p.reached for p in points] == ([22.0, 27.25, 29.5] if known else [None] * 3)
    assert all(("with other settings" in p.worth) is not known for p in points)


def test_of_an_older_front_that_does_not_say_how_it_was_measured_nothing_is_known(
    finished: Pipeline, tmp_path: Path
) -> None:
    write_parquet(tmp_path / "old.parquet", [row("24", "none", "0", 1.0, 22.0, True)], {"sequence": "walk"})
    (point,) = front_points(tmp_path / "old.parquet", [session_of(finished).undecided(NAME, ())])
    assert point.reached is None


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (2, ("frames.size=24", "network.weights=none")),
        (6, ("frames.size=null", "network.weights=none")),
        (20, ("frames.size=null", "network.weights=auto")),
    ],
)
def test_a_budget_buys_from_the_front_and_what_the_user_set_stays(
    finished: Pipeline, table: Path, monkeypatch: pytest.MonkeyPatch, seconds: float, words: tuple[str, ...]
) -> None:
    session = session_of(finished, "refinement.steps=7")
    took = {(24, "none"): 1.0, (None, "none"): 4.0, (None, "auto"): 9.0}
    frames = len(finished.context().source_frames)
    monkeypatch.setattr(Probe, "rates", lambda probe, values: {})
    monkeypatch.setattr(
        expected, "seconds", lambda _, v, *rest: (took[v["frames.size"], v["network.weights"]] * frames, 0.0)
    )
    settled = bought(session, [NAME], (), Selection(), f"{seconds}s/frame", front=table)
    assert settled.words == words
    assert settled.choice is not None
    assert "its quality with your own refinement.steps was not measured" in settled.choice.sentences()[0]
    load_configuration(None, list(settled.words))  # words of `--set`


def test_what_is_no_front_is_refused_in_a_sentence(
    finished: Pipeline, table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=r"a tradeoff\.parquet is expected"):
        front_points(tmp_path / "none.parquet", ())
    (tmp_path / "text.parquet").write_text("no table")
    with pytest.raises(ConfigError, match=r"a tradeoff\.parquet is expected"):
        front_points(tmp_path / "text.parquet", ())
    write_parquet(tmp_path / "other.parquet", [{"a": 1}], {"sequence": "walk"})
    with pytest.raises(ConfigError, match="its columns are a"):
        front_points(tmp_path / "other.parquet", ())
    write_parquet(tmp_path / "beaten.parquet", [row("24", "none", "0", 1.0, 22.0, False)], {"sequence": "walk"})
    with pytest.raises(ConfigError, match="no line of it is on the front"):
        front_points(tmp_path / "beaten.parquet", ())
    unmeasured = {**row("24", "none", "0", 1.0, 22.0, True), "psnr box dB": None}
    write_parquet(tmp_path / "unmeasured.parquet", [unmeasured], {"sequence": "walk"})
    with pytest.raises(ConfigError, match="no line of it is on the front with a number of psnr box dB"):
        front_points(tmp_path / "unmeasured.parquet", ())
    write_parquet(tmp_path / "older.parquet", [row("24", "none", "many", 1.0, 22.0, True)], {"sequence": "walk"})
    with pytest.raises(ConfigError, match=r"line 1 of older\.parquet: refinement\.steps"):
        bought(session_of(finished), [NAME], (), Selection(), "9s/frame", front=tmp_path / "older.parquet")
    with pytest.raises(ConfigError, match="a front is for an amount of time"):
        bought(session_of(finished), [NAME], (), Selection(), "preview", front=table)
    found = CliRunner().invoke(app, ["run", "--archive", str(finished.root), "--front", str(table)])
    assert isinstance(found.exception, ConfigError)
    assert "is for --budget" in str(found.exception)


def test_nothing_that_fits_names_what_the_cheapest_takes(
    finished: Pipeline, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Probe, "rates", lambda probe, values: {})
    monkeypatch.setattr(expected, "seconds", lambda *_: (1e3, 0.0))
    with pytest.raises(ConfigError, match=r"the cheapest settings already take line 3 of tradeoff.* 22\.00 dB on held"):
        affordable(session_of(finished), [NAME], (), Amount.of("1s/frame"), Selection(), front_points(table, ()))


@pytest.mark.parametrize(("amount", "helps"), [("1s/frame", False), ("2s", True)])
def test_fewer_frames_are_advised_where_they_help(
    finished: Pipeline, table: Path, monkeypatch: pytest.MonkeyPatch, amount: str, helps: bool
) -> None:
    """An amount a frame is harder to meet with fewer: they share what is made once."""
    monkeypatch.setattr(Probe, "rates", lambda probe, values: {})
    monkeypatch.setattr(expected, "seconds", lambda *_: (1e3, 0.0))
    with pytest.raises(ConfigError, match=r"give at least [\d.]+s.* fewer views by views\.sources") as told:
        affordable(session_of(finished), [NAME], (), Amount.of(amount), Selection(), front_points(table, ()))
    assert ("fewer frames by frames.range" in str(told.value)) is helps
