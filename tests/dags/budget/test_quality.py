"""Settings by quality: the cheapest that reach what is asked for, measured as a run would measure it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from rich.console import Console
from typer.testing import CliRunner

from posegaussian.dags.budget import expected
from posegaussian.dags.budget.bought import bought
from posegaussian.dags.budget.choice import good_enough
from posegaussian.dags.budget.decibels import Decibels
from posegaussian.dags.budget.points import POINTS, preset
from posegaussian.dags.budget.probe import Probe
from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics.held_out_quality import quality
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError
from tests.dags.budget.test_front_table import table
from tests.support.pipeline import NAME, Pipeline

__all__ = ["table"]
HELD_OUT = "views.held_out=[mid00]"


def session_of(pipeline: Pipeline, *more: str) -> Session:
    assignments = ["run.scheduler=serial", "run.report=off", HELD_OUT, *more]
    return Session(load_configuration(None, assignments, folder=pipeline.root), str(pipeline.root), Console(quiet=True))


@pytest.mark.parametrize(("text", "psnr"), [("28dB", 28), (" 27.5 db ", 27.5), (".5dB", 0.5)])
def test_decibels_are_read(text: str, psnr: float) -> None:
    assert Decibels.of(text) == Decibels(psnr)
    assert Decibels.of(str(Decibels.of(text))) == Decibels(psnr)


@pytest.mark.parametrize("text", ["", "28", "dB", "-3dB", "0dB", "101dB", "nan dB", "3s/frame", "2.8.1dB"])
def test_what_is_no_quality_is_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match="--quality"):
        Decibels.of(text)


@settings(max_examples=20)
@drawn(
    st.lists(st.floats(5, 40), min_size=len(POINTS), max_size=len(POINTS)),
    st.lists(st.floats(5, 40), min_size=2, max_size=2).map(sorted),
)
def test_better_pictures_never_cost_less_and_nothing_cheaper_is_as_good(
    finished: Pipeline, reach: list[float], wanted: list[float]
) -> None:
    cost = [-1]
    for psnr in wanted:
        good, drawn_so = [n for n, r in enumerate(reach) if r >= psnr], iter(reach)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Probe, "rates", lambda probe, values: {})
            patch.setattr(Probe, "reached", lambda probe, values, drawn_so=drawn_so: next(drawn_so))
            patch.setattr(expected, "seconds", lambda *_: (1.0, 0.0))
            if not good:
                most = Decibels.below(max(reach))
                with pytest.raises(ConfigError, match=f"ask for at most {most},"):
                    good_enough(session_of(finished), [NAME], (), Decibels(psnr), Selection())
                assert most.psnr <= max(reach) < most.psnr + 0.1 + 1e-9
                continue
            made = good_enough(session_of(finished), [NAME], (), Decibels(psnr), Selection())
        assert made.chosen.point == POINTS[good[0]]
        assert made.cheaper is None if good[0] == 0 else made.cheaper.point == POINTS[good[0] - 1]
        cost.append(good[0])
    assert cost == sorted(cost)


def test_what_is_measured_is_what_a_run_of_these_frames_has(finished: Pipeline, tmp_path: Path) -> None:
    pipeline = finished.copy(tmp_path / "archive").with_settings("frames.range=0:4")
    probe = Probe(pipeline.session.undecided(NAME, ()), pipeline.session, 2, compared=True)
    try:
        for values in ({}, {"frames.size": 24}):
            probe.rates(values)
        large, small = probe.reached({}), probe.reached({"frames.size": 24})
    finally:
        probe.clean()
    pipeline.run("held_out")
    context = pipeline.context("held_out")
    assert large == quality(context, context)["psnr box"]
    assert small < large


def test_a_run_by_quality_runs_as_its_settings_would_and_leaves_no_trial(finished: Pipeline, tmp_path: Path) -> None:
    copy = finished.copy(tmp_path / "archive")
    fixed = ("run.scheduler=serial", "run.report=off", HELD_OUT, "frames.range=0:2")
    words = ["--archive", str(copy.root), *(word for a in fixed for word in ("--set", a))]
    done = CliRunner().invoke(app, ["run", "--quality", "3dB", *words])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "quality 3dB, 2 frames: preview" in said
    assert "dB on held-out cameras" in said
    assert "were expected" in said
    (reached,) = re.findall(
        r"held-out cameras reached ([\d.]+) dB in the box, mean of 2 pictures, [\d.]+ dB were", said
    )
    made = max((copy.root / NAME / "metrics").rglob("*.parquet"), key=lambda f: f.stat().st_mtime)
    rows = [r for r in pq.read_table(made).to_pylist() if (r["measure"], r["region"]) == ("psnr", "box")]
    assert float(reached) == pytest.approx(np.mean([r["value"] for r in rows]), abs=0.0051)
    assert not list((copy.root / "_variants").iterdir())
    chosen = [w for k, v in preset("preview").values(48).items() for w in ("--set", f"{k}={v}")]
    again = CliRunner().invoke(app, ["run", *words, *chosen])
    assert "all fresh, nothing to do" in again.output


def test_what_a_front_measured_is_not_measured_again(
    finished: Pipeline, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Probe, "rates", lambda probe, values: {})
    monkeypatch.setattr(Probe, "reached", lambda probe, values: pytest.fail("measured"))
    monkeypatch.setattr(expected, "seconds", lambda *_: (1.0, 0.0))
    settled = bought(session_of(finished), [NAME], (), Selection(), quality="27dB", front=table)
    assert settled.words == ("frames.size=null", "network.weights=none", "refinement.steps=20")
    assert settled.choice is not None
    told = settled.choice.sentences()
    assert ["27.25 dB" in told[0], "29.50 dB" in told[1], "22.00 dB" in told[2]] == [True] * 3
    with pytest.raises(ConfigError, match=r"reach 29\.50 dB; ask for at most 29\.5dB"):
        bought(session_of(finished), [NAME], (), Selection(), quality="29.6dB", front=table)
    with monkeypatch.context() as patch:  # with a setting of one's own nothing of it was measured
        patch.setattr(Probe, "reached", lambda probe, values: 27.5)
        own = bought(session_of(finished, "refinement.steps=7"), [NAME], (), Selection(), quality="27dB", front=table)
        assert own.words == ("frames.size=24", "network.weights=none")


def test_what_a_front_measured_with_other_settings_is_measured(
    finished: Pipeline, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Probe, "rates", lambda probe, values: {})
    monkeypatch.setattr(Probe, "reached", lambda probe, values: 19.0 if values["network.weights"] == "none" else 28.0)
    monkeypatch.setattr(expected, "seconds", lambda *_: (1.0, 0.0))
    other = session_of(finished, "rendering.sources=1")
    settled = bought(other, [NAME], (), Selection(), quality="27dB", front=table)
    assert settled.words == ("frames.size=null", "network.weights=auto", "refinement.steps=50")
    assert settled.choice is not None
    assert settled.choice.chosen.promised == 28.0
    alone = session_of(finished, "rendering.sources=1", "views.held_out=[]")
    with pytest.raises(ConfigError, match=r"or give a --front that was measured with these settings"):
        bought(alone, [NAME], (), Selection(), quality="27dB", front=table)


@pytest.mark.parametrize("psnr", [22.785, 22.79, 22.7949])
def test_what_is_shown_to_be_reached_is_reached(psnr: float) -> None:
    assert Decibels.of("22.79dB").met(psnr)
    assert not Decibels.of("22.8dB").met(psnr)
    assert not Decibels.of("22.79dB").met(22.784)


def test_nothing_to_measure_by_is_said(finished: Pipeline) -> None:
    with pytest.raises(ConfigError, match=r"is held out to measure by; keep some aside.*views\.held_out=\["):
        good_enough(session_of(finished, "views.held_out=[]"), [NAME], (), Decibels(20), Selection())
    with pytest.raises(ConfigError, match="either chooses the settings"):
        bought(session_of(finished), [NAME], (), Selection(), "3s/frame", "20dB")
