"""A verdict follows from its bounds, and what is worst is told first."""

from __future__ import annotations

import pytest

from posegaussian.stages.inspection.finding import FindingVerdict, graded, measured, overall, unmeasured, worst_first


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
