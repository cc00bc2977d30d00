"""A verdict follows from its bounds, and what is worst is told first."""

from __future__ import annotations

from math import inf

import pytest

from posegaussian.stages.inspection.finding import (
    FindingVerdict,
    graded,
    left_out,
    measured,
    overall,
    unmeasured,
    worst_first,
)


@pytest.mark.parametrize(
    ("value", "good", "bad", "verdict"),
    [
        (1.0, 1.0, 2.0, FindingVerdict.GOOD),
        (1.5, 1.0, 2.0, FindingVerdict.DOUBTFUL),
        (2.0, 1.0, 2.0, FindingVerdict.DOUBTFUL),
        (2.1, 1.0, 2.0, FindingVerdict.BAD),
        (0.98, 0.98, 0.9, FindingVerdict.GOOD),
        (0.95, 0.98, 0.9, FindingVerdict.DOUBTFUL),
        (0.8, 0.98, 0.9, FindingVerdict.BAD),
    ],
)
def test_bounds_work_both_ways(value: float, good: float, bad: float, verdict: FindingVerdict) -> None:
    assert graded(value, good, bad) is verdict


def test_worst_first_and_advice_only_where_something_is_wrong() -> None:
    good, poor, bad, worse = (measured("m", ("a",), v, "px", 1, 2, "s", "do") for v in (0.5, 1.5, 3.0, 9.0))
    unknown = unmeasured("m", ("b",), "px", 1, 2, "why")
    assert worst_first([good, unknown, poor, bad, worse]) == [worse, bad, poor, unknown, good]
    assert [f.advice for f in (good, poor)] == ["", "do"]
    assert overall([good, unknown, poor]) is FindingVerdict.DOUBTFUL
    assert overall([unknown]) is FindingVerdict.UNKNOWN
    assert unknown.number == "-"
    assert poor.bounds == "good at most 1, bad above 2"


def test_a_bound_that_nothing_reaches_and_a_number_that_is_one_are_said_in_words() -> None:
    few = measured("cameras", (), 2, "sources", 5, -inf, "s", "do")
    assert few.verdict is FindingVerdict.DOUBTFUL
    assert few.bounds == "good at least 5, never bad"
    assert measured("m", ("a",), 7.28, "px", 1, 2, "s", "do", at_least=True).number == "at least 7.28 px"
    assert measured("m", ("a",), 0.0, "px", 1, 2, "s", "do", at_least=True).number == "0 px"


def test_what_is_wrong_with_a_camera_that_is_left_out_keeps_its_advice_and_does_not_count() -> None:
    good, bad = (measured("m", ("a",), v, "px", 1, 2, "s", "do") for v in (0.5, 3.0))
    assert left_out(good) == good
    assert (left_out(bad).advice, left_out(bad).value) == ("do", 3.0)
    assert overall([good, left_out(bad)]) is FindingVerdict.GOOD
    assert overall([left_out(bad)]) is FindingVerdict.UNKNOWN


def test_the_cause_is_told_before_what_follows_from_it() -> None:
    """However far beyond its bounds either is."""
    cause = measured("mask at the rim", ("a",), 1.0, "", 0.5, 0.75, "s", "do")
    follows = [measured("mask agreement", (n,), 0.2, "", 0.98, 0.9, "s", "do") for n in "bc"]
    doubtful = measured("mask at the rim", ("d",), 0.6, "", 0.5, 0.75, "s", "do")
    assert follows[0].excess > cause.excess
    assert worst_first([*follows, doubtful, cause]) == [cause, *follows, doubtful]
