"""Settings by time: more time never buys less, what the user set stays, and measuring leaves nothing behind."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from rich.console import Console
from typer.testing import CliRunner

from posegaussian.dags.budget import choice, expected
from posegaussian.dags.budget.amount import UNITS, Amount
from posegaussian.dags.budget.choice import affordable, preset_values
from posegaussian.dags.budget.expected import START, distinct, given
from posegaussian.dags.budget.points import POINTS, PRESETS, preset
from posegaussian.dags.budget.probe import Probe
from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.resources import CPU, Pool
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline, film

FIXED = ("run.scheduler=serial", "run.report=off", "views.held_out=[mid00]", "partition.frames=2")


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("budget")
    film(folder / "capture", views=4, frames=6, depth=False)
    pipeline = Pipeline(folder / "archive", folder / "capture")
    pipeline.register()
    return pipeline


def session_of(pipeline: Pipeline, *assignments: str) -> Session:
    configuration = load_configuration(None, [*FIXED, *assignments], folder=pipeline.root)
    return Session(configuration, str(pipeline.root), Console(quiet=True))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("a_frame", [True, False])
def test_amounts_are_read_in_every_unit(unit: str, a_frame: bool) -> None:
    amount = Amount.of(f" 1.5 {unit}{' / frame' if a_frame else ''}")
    assert (amount.seconds, amount.a_frame) == (1.5 * UNITS[unit], a_frame)
    assert str(amount) == f"1.5 {unit}{' / frame' if a_frame else ''}", "as it was written"
    for seconds in (7.3e-3, 7.3, 7.3e3):
        assert Amount.of(amount.enough(seconds, 10)).over(10) >= seconds, "what is advised is enough"
    assert amount.over(10) == pytest.approx(amount.seconds * (10 if a_frame else 1))


@pytest.mark.parametrize(
    "text", ["", "3", "fast", "-1s", "1e9s", "0s", "0ms/frame", "9999h", "1s/view", "nan s", "1.2.3s"]
)
def test_what_is_no_amount_is_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match="--budget"):
        Amount.of(text)


def test_points_go_from_cheap_and_coarse_to_dear_and_fine() -> None:
    assert [p.against for p in POINTS] == sorted(p.against for p in POINTS)
    assert len({p.name for p in POINTS}) == len(POINTS)
    assert set(PRESETS) <= {p.name for p in POINTS}


def test_balanced_is_what_runs_by_default() -> None:
    default = load_configuration(None, []).default
    for knob, value in preset("balanced").settings.items():
        stage, _, key = knob.partition(".")
        assert getattr(getattr(default, stage), key) == value, knob


def test_what_the_user_set_stays(filmed: Pipeline) -> None:
    session = session_of(filmed, "refinement.steps=7", f"sequences={{{NAME}: {{depth: {{method: sgbm}}}}}}")
    assert {"refinement.steps", "depth.method"} <= given(session.configuration)
    assert preset_values(session, [NAME], "preview") == {"network.weights": "none", "frames.size": 24}
    for _, values in distinct([filmed.context()], given(session.configuration)):
        assert not {"refinement.steps", "depth.method"} & values.keys()


def test_no_two_points_set_the_same(filmed: Pipeline) -> None:
    for own in ((), ("refinement.steps",), ("depth.method", "network.weights"), tuple(POINTS[1].settings)):
        found = [tuple(sorted(values.items())) for _, values in distinct([filmed.context()], own)]
        assert len(found) == len(set(found)) >= 2


def test_a_capture_that_has_no_choice_of_depth_is_left_its_own(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=1, frames=2, held_out=0, masks=False)
    single = Pipeline(tmp_path / "archive", tmp_path / "capture", ["depth.method=auto"], held_out="[]")
    single.register()
    for _, values in distinct([single.context()], ()):
        assert "depth.method" not in values


@settings(max_examples=20)
@drawn(
    st.lists(st.floats(0.01, 9), min_size=len(POINTS), max_size=len(POINTS)).map(sorted),
    st.lists(st.floats(0.1, 12), min_size=2, max_size=2).map(sorted),
)
def test_more_time_never_buys_less(filmed: Pipeline, took: list[float], budgets: list[float]) -> None:
    bought, frames = [-100.0], len(filmed.context().source_frames)
    for seconds in budgets:
        fits = [n for n, t in enumerate(took) if t * frames <= seconds * frames]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Probe, "rates", lambda probe, values: {})
            patch.setattr(expected, "seconds", lambda _, values, *rest: (took[number_of(values)] * frames, 0.0))
            if not fits:
                with pytest.raises(ConfigError, match="the cheapest settings already take"):
                    affordable(session_of(filmed), [NAME], (), Amount(seconds, True, ""), Selection())
                continue
            made = affordable(session_of(filmed), [NAME], (), Amount(seconds, True, ""), Selection())
        assert made.chosen.point == POINTS[fits[-1]]
        assert made.cheaper is None if len(fits) == 1 else made.cheaper.point == POINTS[fits[-2]]
        assert made.better is None if len(fits) == len(POINTS) else made.better.point == POINTS[fits[-1] + 1]
        bought.append(made.chosen.point.against)
    assert bought == sorted(bought)


def number_of(values: dict[str, Any]) -> int:
    """Place among all points of the one that sets these values of `filmed`."""
    return next(n for n, p in enumerate(POINTS) if p.values(48) == values)


@settings(max_examples=20)
@drawn(st.floats(0.5, 40), st.floats(0, 30), st.floats(0.2, 5))
def test_few_settings_are_tried_where_they_take_what_they_took_elsewhere(
    filmed: Pipeline, budget: float, once: float, slower: float
) -> None:
    tried: list[int] = []

    def seconds(contexts: object, values: dict[str, Any], *_: object) -> tuple[float, float]:
        tried.append(number_of(values))
        return once + slower * POINTS[tried[-1]].seconds * frames, once

    frames = len(filmed.context().source_frames)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Probe, "rates", lambda probe, values: {})
        patch.setattr(expected, "seconds", seconds)
        with contextlib.suppress(ConfigError):
            affordable(session_of(filmed), [NAME], (), Amount(budget, True, ""), Selection())
    assert len(tried) == len(set(tried)) <= 4, "the cheapest, what is chosen and its neighbours"
    assert tried[0] == 0


@pytest.mark.parametrize(("workers", "partitions", "frames"), [(1, 3, 4), (2, 1, 4), (2, 3, 6), (9, 3, 6)])
def test_as_many_workers_are_measured_as_will_have_something_to_do(
    filmed: Pipeline, monkeypatch: pytest.MonkeyPatch, workers: int, partitions: int, frames: int
) -> None:
    class Workers(SerialBackend):
        pools = property(lambda _: {CPU: Pool(workers, 0, None)})  # type: ignore[assignment]

    session = session_of(filmed)
    monkeypatch.setattr(Session, "backend", lambda *_: Workers())
    probe = Probe(session.undecided(NAME, ()), session, partitions)
    assert (probe.workers, probe.frames) == (workers, frames), "of the six that there are"


def test_a_probe_deletes_what_it_made_and_nothing_of_another_one(filmed: Pipeline, tmp_path: Path) -> None:
    """Of the same sequence and settings, and of another sequence with the same frames."""
    copy = filmed.copy(tmp_path / "archive")
    shutil.copytree(copy.root / NAME, copy.root / "other")
    session = session_of(copy)
    probes = [Probe(session.undecided(name, ()), session, 1) for name in (NAME, NAME, "other")]
    for probe in probes:
        probe.start()
    folders = [probe._variant({}).sequence.root for probe in probes]
    assert [probe._variant({}).sequence.root for probe in probes] == folders, "a probe finds its own again"
    for n, probe in enumerate(probes, 1):
        probe.clean()
        assert [f.is_dir() for f in folders] == [i >= n for i in range(3)]
    assert not list((copy.root / "_variants").iterdir())


def test_what_is_expected_grows_with_the_work_and_ends_when_all_is_done(filmed: Pipeline, tmp_path: Path) -> None:
    copy = filmed.copy(tmp_path / "archive")
    values = preset("preview").values(48)

    def took(frames: int, rate: float) -> float:
        session = session_of(copy, f"frames.range=0:{frames}")
        return expected.seconds(
            session_contexts(session), values, dict.fromkeys(("frames", "depth", "gaussians"), rate), 1
        )[0]

    more = [took(frames, 1e-4) - START for frames in (2, 4, 6)]
    assert more[0] > 0
    assert more == pytest.approx([more[0], 2 * more[0], 3 * more[0]])
    assert took(4, 3e-4) - START == pytest.approx(3 * more[1])
    words = [w for k, v in values.items() for w in ("--set", f"{k}={v}")]
    fixed = [word for a in (*FIXED, "frames.range=0:4") for word in ("--set", a)]
    done = CliRunner().invoke(app, ["run", "--archive", str(copy.root), *fixed, *words])
    assert done.exit_code == 0, done.output
    assert took(4, 1e-4) == START


def test_pictures_of_a_path_that_the_survey_decided_on_are_counted(
    filmed: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which cameras are believed may change it."""
    made = expected.make_plan

    def decided(context: Context, selection: Selection) -> Plan:
        return made(make_context(context.sequence, context.settings, ("orbit",)), selection)

    monkeypatch.setattr(expected, "make_plan", decided)
    took, once = expected.seconds(session_contexts(session_of(filmed)), {}, {"rendering": 1e-4}, 1)
    assert took > once


def session_contexts(session: Session) -> list[Context]:
    return [make_context(session.archive.sequence(NAME), session.configuration.for_sequence(NAME), ())]


def test_a_budget_that_nothing_fits_says_what_would_and_leaves_nothing(filmed: Pipeline) -> None:
    before = sorted(p.relative_to(filmed.root) for p in filmed.root.rglob("*"))
    words = [word for a in (*FIXED, "frames.range=0:2") for word in ("--set", a)]
    done = CliRunner().invoke(app, ["run", "--archive", str(filmed.root), "--budget", "1ms/frame", *words])
    assert isinstance(done.exception, ConfigError)
    assert "the cheapest settings already take preview" in str(done.exception)
    assert "--budget 1ms/frame: " in str(done.exception)
    assert "give at least" in str(done.exception)
    after = sorted(p.relative_to(filmed.root) for p in filmed.root.rglob("*"))
    assert [p for p in after if p not in before] in ([], [Path("_variants")])


def test_a_preset_runs_as_its_settings_would(filmed: Pipeline, tmp_path: Path) -> None:
    copy = filmed.copy(tmp_path / "archive")
    words = ["--archive", str(copy.root), *(word for a in (*FIXED, "frames.range=0:2") for word in ("--set", a))]
    done = CliRunner().invoke(app, ["run", "--budget", "preview", *words])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "--set depth.method=hull --set network.weights=none --set refinement.steps=0 --set frames.size=24" in said
    chosen = [w for k, v in preset("preview").values(48).items() for w in ("--set", f"{k}={v}")]
    again = CliRunner().invoke(app, ["run", *words, *chosen])
    assert "all fresh, nothing to do" in again.output


@settings(max_examples=60)
@drawn(
    st.lists(st.floats(1, 90), min_size=len(POINTS), max_size=len(POINTS)).map(sorted),
    st.lists(st.floats(0.1, 60), min_size=len(POINTS), max_size=len(POINTS)),
    st.floats(5, 200),
    st.booleans(),
)
def test_what_fitted_when_it_was_measured_is_not_lost_to_measuring(
    filmed: Pipeline, took: list[float], probes: list[float], budget: float, even: bool
) -> None:
    """Of probes that take no longer than the first the dearest that fitted is run, and ends in time; others may take
    what was left, and then it is one that fitted."""
    clock, fitted = [0.0], list[int]()
    if took[0] + probes[0] > budget:
        return  # not even the cheapest fits

    def seconds(contexts: object, values: dict[str, Any], *_: object) -> tuple[float, float]:
        n = number_of(values)
        clock[0] += probes[0] if even else probes[n]
        fitted.extend([n] if took[n] <= budget - clock[0] else [])
        return took[n], 0.0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choice, "time", SimpleNamespace(monotonic=lambda: clock[0]))
        patch.setattr(Probe, "rates", lambda probe, values: {})
        patch.setattr(expected, "seconds", seconds)
        made = affordable(session_of(filmed), [NAME], (), Amount(budget, False, ""), Selection())
    assert number_of(dict(made.chosen.values)) in fitted
    if even:
        assert made.chosen.point == POINTS[max(fitted)]
        assert clock[0] + made.chosen.seconds <= budget + 1e-9
