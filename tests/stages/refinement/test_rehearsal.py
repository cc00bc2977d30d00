"""At which step a rehearsal ends, by what the judge says alone."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posegaussian.stages.refinement import rehearsal
from posegaussian.stages.refinement.judging import Judgement
from posegaussian.stages.refinement.rehearsal import ALIKE, JUDGED_EVERY, PATIENCE, Rehearsal, rehearse
from posegaussian.stages.refinement.schedule import Schedule

BEFORE = 1.0
PLAN = Schedule(0, (), (1, 2))


def rehearsed(errors: Sequence[float], worth: float = 0.0) -> Rehearsal:
    """Where the judge says these errors, one every ten steps."""
    said = iter(errors)
    walk = SimpleNamespace(step=lambda: None, reached=SimpleNamespace(gaussians=None), masked=0)
    judge: Any = SimpleNamespace(before=BEFORE, judgement=lambda _: Judgement(next(said), 0.5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rehearsal, "begin", lambda *_: walk)
        return rehearse({}, {}, PLAN, len(errors) * JUDGED_EVERY, worth, judge)


@given(st.lists(st.floats(0.1, 1.5), min_size=1, max_size=20))
def test_what_is_kept_is_as_good_as_the_best_that_was_judged_and_better_than_none(errors: list[float]) -> None:
    found = rehearsed(errors)
    assert found.refines == (found.step > 0)
    if found.refines:
        judged = errors[: found.step // JUDGED_EVERY + PATIENCE]
        assert found.after == errors[found.step // JUDGED_EVERY - 1]
        assert found.after < BEFORE
        assert found.after <= ALIKE * min(judged)
    else:
        assert min(errors[:PATIENCE]) >= BEFORE


@given(st.lists(st.floats(1.0, ALIKE), min_size=2, max_size=20))
def test_chance_ends_nothing_where_any_gain_is_worth_it(noise: list[float]) -> None:
    """Errors that differ by less than judgements do anyway: all steps are made, whichever was least."""
    assert rehearsed([0.5 * n for n in noise]).step == len(noise) * JUDGED_EVERY


def test_what_becomes_worse_ends_where_it_was_best() -> None:
    falling, rising = [0.9, 0.8, 0.7], [0.7 * 1.02**n for n in range(1, 12)]
    assert rehearsed(falling + rising).step == 3 * JUDGED_EVERY
    flat = [0.7 * ALIKE**0.5] * 3
    assert rehearsed(falling + flat, worth=0.05).step == 3 * JUDGED_EVERY, "steps that must be worth it are not made"
    assert rehearsed(falling + flat).step == 6 * JUDGED_EVERY
