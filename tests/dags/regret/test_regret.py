"""What decisions about effects cost: one is turned, all else stays as it was decided, and nothing of the user's
changes."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.regret.regret import Regret, Turned, as_lines, box_psnr, measured, rows
from posegaussian.dags.regret.switches import pinned, switches
from posegaussian.dags.tradeoff.tradeoff import level_settings
from posegaussian.storage.model.errors import UserError
from tests.dags.tradeoff.test_tradeoff import files
from tests.support.pipeline import NAME, Pipeline

FEW = ("frames.range=0:1",)


@pytest.fixture(scope="module")
def tried(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, Regret, dict]:
    """Every effect of one frame turned: (archive, what came out, files before)."""
    archive = finished.copy(tmp_path_factory.mktemp("regret") / "archive").with_settings(*FEW)
    before = files(archive.root / NAME)
    return archive, measured(archive.session, NAME, pairs=False, repeats=1), before


def test_no_byte_of_the_users_sequence_changes(tried: tuple) -> None:
    archive, _, before = tried
    assert files(archive.root / NAME) == before
    assert archive.session.archive.names() == [NAME]


def test_as_decided_is_what_a_run_makes(tried: tuple, tmp_path: Path) -> None:
    archive, found, _ = tried
    own = archive.copy(tmp_path / "archive")
    own.run()
    context = make_plan(own.context()).context
    assert found.psnr == box_psnr(context, context)


def test_an_effect_is_turned_and_the_others_stay(finished: Pipeline) -> None:
    context = make_plan(finished.with_settings("effects.limb_bounds=on").context()).context
    found, ruled_out = switches(context)
    assert [s.name for s in pickle.loads(pickle.dumps(found))] == [s.name for s in found], "benchmarks send them"
    assert {s.name for s in found} | ruled_out.keys() == context.effects.keys()
    for switch in found:
        settings = level_settings(context, {**pinned(context), f"effects.{switch.name}": switch.other})
        turned = replace(context, settings=settings)
        waits = switch.other == "on" and not set(context.effects[switch.name].effect.uses) <= context.noted.keys()
        state = "undecided" if waits else switch.other  # cameras are turned once it is measured by how much
        assert turned.effects[switch.name].state == state != context.effects[switch.name].state
        others = [n for n in context.effects if n != switch.name and context.effects[n].state == "off"]
        assert all(turned.effects[n].state == "off" for n in others), "none comes on beside it"


def test_what_cannot_be_otherwise_is_told_with_its_reason(tried: tuple) -> None:
    _, found, _ = tried
    told = found.ruled_out["tone_mapping"]
    assert told == "the pictures are display-referred: no source view came as EXR"
    assert "no two cameras share" in found.ruled_out["exposure_matching"], "what a stage refuses while it runs, too"
    assert f"not turned: tone_mapping: {told}" in as_lines(found)


def test_regret_is_the_best_of_what_was_tried() -> None:
    worse, better, all_on = Turned(("a",), -0.2, 1.0), Turned(("b",), 0.3, -0.5), Turned(("everything on",), 0.1, 2.0)
    found = Regret((worse, better), all_on, (), {}, 20.0, 3.0, 1.0)
    assert found.best is better
    assert replace(found, turned=(worse,)).best is all_on
    none = replace(found, turned=(worse,), everything=replace(all_on, gain=-0.1))
    assert (none.best.names, none.best.gain) == ((), 0.0)
    assert any("nothing tried is better, regret 0.00 dB" in line for line in as_lines(none))
    assert [r["costs dB"] for r in rows(found)] == [0.0, 0.3, 0.1]


def test_seconds_and_decibels_are_told_effect_by_effect(tried: tuple) -> None:
    _, found, _ = tried
    singles = [r["effect"] for r in rows(found)][: len(found.switches)]
    assert singles == [s.name for s in found.switches]
    assert found.everything.names == ("everything on",)
    assert found.seconds > 0
    assert "left_right_check" in found.singles


def test_without_a_camera_to_compare_with_it_says_what_to_set(finished: Pipeline) -> None:
    with pytest.raises(UserError, match=r"no camera that pictures could be compared with.*--set 'views\.held_out="):
        measured(finished.with_settings("views.held_out=[]").session, NAME, pairs=False, repeats=1)
