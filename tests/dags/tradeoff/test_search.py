"""A search finds the front in few runs: on seconds and decibels made up, and on a small archive."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.tradeoff.pareto import Level, pareto
from posegaussian.dags.tradeoff.search import (
    Found,
    Tried,
    front_at,
    nearest_to_front,
    rung_sizes,
    search,
    to_screen,
)
from posegaussian.dags.tradeoff.searched import Trials, against_own, run_search, space
from posegaussian.dags.tradeoff.surrogate import Setting, predicted, predicted_seconds
from posegaussian.dags.tradeoff.tradeoff import Clock, with_truth
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline

LEVELS = (3, 4, 2, 3, 3, 2, 4, 4)
OWN = (2, 3, 1, 1, 1, 1, 2, 1)


def made_up(setting: Setting) -> Tried:
    """Seconds that add up over stages and shrink with the picture, decibels that depend on each other, as measured ones
    do: a network improves what was matched more than a hull, and refinement makes sources of no account."""
    size, depth, pairs, weights, iterations, looks, steps, sources = setting
    pixels, refined, learned = (0.25, 0.56, 1.0)[size], (0, 20, 50, 200)[steps], weights > 0
    seconds = {
        "depth": pixels * (1.0, 9.0, 6.0, 12.0)[depth] * (0.6, 1.0)[pairs],
        "network": learned * pixels * (2.0, 4.0, 6.0)[iterations] * (0.5, 1.0)[looks] * (1.0, 1.0, 1.3)[weights],
        "refinement": pixels * (2 + 0.15 * refined) if refined else 0.0,
        "rendering": pixels * (0.3 if refined else 0.3 + 0.5 * sources),
    }
    quality = 22 + (0.0, 2.0, 3.5)[size] + (0.0, 2.5, 3.0, 3.1)[depth] * (0.5 + 0.25 * size) + 0.3 * pairs * (depth > 0)
    if learned:
        quality += (0.4, 0.6, 0.7)[iterations] * (1 + (depth > 0)) + 0.1 * looks - 0.2 * (weights == 2)
    quality += (0.0, 1.5, 1.9, 2.0)[steps] * (1.0 if depth else 0.4)
    return Tried(seconds, quality if refined else quality + (0.0, 0.5, 0.6, 0.55)[sources])


EVERY: Found = {s: made_up(s) for s in itertools.product(*(range(n) for n in LEVELS))}
BUDGETS = np.geomspace(min(t.total for t in EVERY.values()), max(t.total for t in EVERY.values()), 48)
WORST = min(t.quality for t in EVERY.values())


class Noting:
    """A trial that notes what it was asked for."""

    def __init__(self) -> None:
        self.tried: list[tuple[Setting, int]] = []

    def __call__(self, setting: Setting, rung: int) -> Tried:
        self.tried.append((setting, rung))
        return made_up(setting)


def below_front(found: Found) -> float:
    """Below the true front, dB, mean over budgets; where nothing found is as cheap, what the worst setting lacks."""
    cheapest = min(t.total for t in found.values())
    reached = np.where(cheapest > BUDGETS, WORST, front_at(found, BUDGETS))
    return float((front_at(EVERY, BUDGETS) - reached).mean())


def test_sixty_runs_of_seven_thousand_settings_find_the_front() -> None:
    trial = Noting()
    last = search(LEVELS, OWN, 3, 60, trial)
    rungs = [rung for _, rung in trial.tried]
    assert [rungs.count(r) for r in range(3)] == rung_sizes(3, 60)
    assert OWN in last, "what is set today is measured to the end"
    tried = {s: EVERY[s] for s, _ in trial.tried}
    others = np.random.default_rng(0).choice(len(EVERY), len(tried), replace=False)
    at_random = {s: EVERY[s] for s in (list(EVERY)[i] for i in others)}
    # 0.20 dB, 1.4 dB at random: half way between, by their ratio, tells a search from a lottery
    assert below_front(tried) < 0.5 < below_front(at_random)
    # eight settings span a front of 12 dB by steps
    assert below_front(last) < 1
    totals = [t.total for t in tried.values()]
    assert min(totals) < 1.1 * BUDGETS[0], "the cheap end is looked at, too"


def test_the_same_search_twice_tries_the_same() -> None:
    first, second = Noting(), Noting()
    for trial in (first, second):
        search(LEVELS, OWN, 2, 30, trial)
    assert first.tried == second.tried


def test_a_small_space_is_tried_whole_and_no_setting_twice() -> None:
    trial = Noting()
    levels = (1, 2, 1, 1, 1, 1, 3, 1)
    found = search(levels, (0, 1, 0, 0, 0, 0, 2, 0), 1, 6, trial)
    assert len(trial.tried) == len(found) == 6
    assert set(found) == set(itertools.product(*(range(n) for n in levels)))


def test_settings_that_cannot_be_run_are_left_out() -> None:
    found = search(LEVELS, OWN, 2, 40, lambda s, rung: None if s[3] == 2 else made_up(s))
    assert found
    assert all(s[3] != 2 for s in found)
    assert search((2, 2), (0, 0), 2, 10, lambda s, rung: None) == {}


@pytest.mark.parametrize("rungs", [1, 2, 3, 4])
@pytest.mark.parametrize("runs", [15, 60, 200])
def test_rungs_halve_and_use_what_there_is(rungs: int, runs: int) -> None:
    sizes = rung_sizes(rungs, runs)
    assert len(sizes) == rungs
    assert sum(sizes) == runs
    assert all(a == 2 * b for a, b in itertools.pairwise(sizes[1:]))
    assert sizes == sorted(sizes, reverse=True)


def test_screening_changes_one_knob_and_reaches_every_level() -> None:
    settings = list(to_screen(LEVELS, OWN))
    assert settings[:2] == [OWN, (0,) * len(LEVELS)]
    assert len(set(settings)) == len(settings) == 2 + sum(n - 1 for n in LEVELS)
    assert all(sum(a != b for a, b in zip(s, OWN, strict=True)) == 1 for s in settings[2:])
    near = list(to_screen((2, 2), (0, 1)))
    assert len(set(near)) == len(near) == 3


def test_what_was_tried_is_predicted_as_it_was_and_what_is_like_it_is_surer() -> None:
    settings = list(to_screen(LEVELS, OWN))
    quality = np.array([made_up(s).quality for s in settings])
    mean, deviation = predicted(settings, quality, settings, LEVELS)
    # noise of a thousandth of the variance is allowed for: 3 % of the spread
    assert np.abs(mean - quality).max() < 0.1 * quality.std()
    assert (predicted(settings, np.full(len(settings), 7.0), [OWN], LEVELS)[0] == 7).all(), "equals are no surprise"
    far = tuple(n - 1 - i for n, i in zip(LEVELS, OWN, strict=True))
    assert predicted(settings, quality, [far], LEVELS)[1][0] > 2 * deviation.max()


def test_seconds_of_stages_are_predicted_apart_and_added() -> None:
    """From single changes alone: stages that shrink with the picture shrink together."""
    settings = list(to_screen(LEVELS, OWN))
    asked = [(0, 0, 0, 0, 1, 1, 0, 1), (0, 2, 1, 1, 1, 1, 1, 1), (1, 3, 1, 1, 2, 0, 2, 1)]
    told = predicted_seconds(settings, [made_up(s).seconds for s in settings], asked, LEVELS)
    true = np.array([made_up(s).total for s in asked])
    # 0.35 to 14 s are told from single changes of a setting of 26 s: to less than half of the way from there
    assert (np.abs(np.log(told / true)) < 0.5 * np.log(made_up(OWN).total / true)).all()


@given(
    st.lists(
        st.tuples(st.tuples(st.integers(0, 5), st.integers(0, 5)), st.integers(1, 40), st.integers(0, 30)),
        min_size=1,
        max_size=20,
        unique_by=lambda t: t[0],
    ),
    st.integers(2, 10),
)
def test_what_goes_on_are_the_own_setting_and_the_front_first(made: list[tuple[Setting, int, int]], count: int) -> None:
    found = {s: Tried({"all": float(t)}, float(q)) for s, t, q in made}
    own = made[0][0]
    kept = nearest_to_front(found, count, own)
    assert len(kept) == min(count, len(found)) == len(set(kept))
    assert own in kept
    totals = [found[s].total for s in kept]
    assert totals == sorted(totals)
    best = pareto([(t.total, -t.quality) for t in found.values()])
    front = {s for s, on in zip(found, best, strict=True) if on}
    assert front <= set(kept) or set(kept) <= front | {own}


@pytest.fixture(scope="module")
def searched(
    finished: Pipeline, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Pipeline, list[Level], tuple[str, ...], Path]:
    """A search over three knobs, 12 settings, on a small archive that has no results yet, in 15 runs: (archive, levels,
    what is better, output). Two source pictures for each are set, and sgbm."""
    folder = tmp_path_factory.mktemp("search")
    archive = Pipeline(folder / "archive", finished.folder)
    archive.register()
    levels = ["depth.method=hull,sgbm", "frames.size=0.5,1.0", "rendering.sources=1,2,3"]
    knobs = ["depth.method", "frames.size", "rendering.sources"]
    return archive, *run_search(archive.session, None, knobs, levels, 15, 1, folder / "out"), folder / "out"


def test_a_search_measures_on_more_frames_what_is_near_the_front(
    searched: tuple[Pipeline, list[Level], tuple[str, ...], Path],
) -> None:
    archive, levels, _, out = searched
    own = {"depth.method": "sgbm", "frames.size": None, "rendering.sources": 2}
    assert own in [level.values for level in levels]
    assert len(levels) == rung_sizes(3, 15)[-1]
    assert {level.context.grid.frames for level in levels} == {6}, "so short a sequence is measured whole at the end"
    assert [level.total for level in levels] == sorted(level.total for level in levels)
    # each shown second was taken here: survey and judge apart, which are done once
    assert all(level.seconds[s] > 0 for level in levels for s in ("frames", "depth", "rendering"))
    table = pq.read_table(out / "tradeoff.parquet")
    assert table.num_rows == len(levels)
    assert {"depth.method", "frames.size", "rendering.sources", "total s/frame", "psnr box dB"} <= {*table.column_names}
    assert (out / "tradeoff.png").is_file()
    assert archive.session.archive.names() == [NAME]


def test_a_second_search_tries_the_same_and_makes_little_anew(
    searched: tuple[Pipeline, list[Level], tuple[str, ...], Path],
) -> None:
    archive, levels, _, out = searched
    knobs = ["depth.method", "rendering.sources"]
    again, _ = run_search(archive.session, NAME, knobs, ["depth.method=hull,sgbm", "rendering.sources=1,2"], 15, 1, out)
    before = {str(level.values): level.quality for level in levels}
    for level in again:
        values = {**level.values, "frames.size": None}
        told = before.get(str({k: values[k] for k in ("depth.method", "frames.size", "rendering.sources")}))
        assert told is None or told == level.quality


def test_what_an_earlier_search_made_is_timed_once_it_ran_in_this_process(
    searched: tuple[Pipeline, list[Level], tuple[str, ...], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = searched[0]
    origin = with_truth(archive.session, NAME)
    trials = Trials(archive.session, origin, space(origin, ["rendering.sources"], ["rendering.sources=1,2,3"]))
    calls: list[tuple[frozenset[str], frozenset[str]]] = []
    run = Clock._run

    def noted(clock: Clock, level: Level, force: frozenset[str]) -> frozenset[str]:
        calls.append((force, run(clock, level, force)))
        return calls[-1][1]

    monkeypatch.setattr(Clock, "_run", noted)
    level = trials._run(trials.own, len(trials.frames) - 1)
    (_, first), (forced, cold), (again, last) = calls
    assert {"frames", "depth", "rendering"} <= forced
    assert (first, cold, again, last) == (frozenset(), forced, forced, frozenset())
    assert all(len(trials.clock.times[s, level.identities[s]]) == 1 for s in forced)


def level(seconds: float, psnr: float, **values: object) -> Level:
    return Level(values, None, seconds={"all": seconds}, quality={"psnr box": psnr})  # type: ignore[arg-type]


def test_what_is_better_than_what_is_set_is_said_as_settings() -> None:
    own = level(10, 28.0, method="auto", size=600)
    finer, same, dearer = (
        level(9, 28.5, method="sweep", size=None),
        level(8, 28.0, method="sgbm", size=600),
        level(11, 30),
    )
    assert against_own([finer, own, dearer], own) == (
        "what is set today is line 2; line 1 has 0.50 dB more and takes no longer: --set method=sweep --set size=null",
        ("method=sweep", "size=null"),
    )
    told, words = against_own([same, own], own)
    assert "line 1 is as good and takes 2.00 s less: --set method=sgbm" in told
    assert words == ("method=sgbm",)
    assert against_own([own, dearer], own) == ("what is set today is line 1; none is better and takes no longer", ())
    assert against_own([dearer], None)[1] == ()
    assert against_own([level(9.9, 28.0, method="sgbm", size=600), own], own)[1] == (), "no more than noise"


def test_what_is_set_is_searched_too_and_what_cannot_be_is_refused_before_anything_runs(finished: Pipeline) -> None:
    context = finished.context("held_out")
    every = space(context, [], [])
    assert every["refinement.steps"] == [0, 20, 50, 200]
    assert every["frames.size"] == [24, 36, None]
    own = finished.with_settings("refinement.steps=7", "frames.size=30").context("held_out")
    assert space(own, ["refinement.steps"], [])["refinement.steps"] == [0, 7, 20, 50, 200]
    assert space(own, ["refinement.steps"], ["refinement.steps=1,2"])["refinement.steps"] == [1, 2, 7]
    assert space(own, ["frames.size"], [])["frames.size"] == [24, 30, 36, None]
    larger = finished.with_settings("frames.size=2000").context("held_out")
    assert space(larger, ["frames.size"], [])["frames.size"] == [24, 36, 2000], "no picture twice"
    with pytest.raises(ConfigError, match="every knob has a single level"):
        space(context, ["depth.method"], ["depth.method=sgbm"])
    with pytest.raises(ConfigError, match="sgmb"):
        space(context, ["depth.method"], ["depth.method=sgmb,hull"])
    assert space(context, ["effects.hole_filling"], [])["effects.hole_filling"] == ["off", "on"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "name a setting, for example --knob"),
        (["--knob", "depth.method", "--runs", "20"], "--runs 20 is for --search"),
    ],
)
def test_options_that_say_nothing_are_refused(finished: Pipeline, words: list[str], told: str) -> None:
    found = CliRunner().invoke(app, ["tradeoff", "--archive", str(finished.root), *words])
    assert isinstance(found.exception, ConfigError)
    assert told in str(found.exception)
