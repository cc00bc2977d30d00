"""Seconds of modules: what is nested counts once, whatever is raised, and the sum is never more than what passed."""

from __future__ import annotations

import time

import pytest

from posegaussian.dags.runtime import meters
from posegaussian.dags.runtime.meters import Stopwatch


class Clock:
    now = 100.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(meters.time, "perf_counter", lambda: clock.now)
    return clock


def test_a_module_is_measured_every_time_and_what_is_between_counts_for_none(clock: Clock) -> None:
    timed = Stopwatch()
    for seconds in (1.0, 2.0):
        clock.now += 8
        with timed("heads"):
            clock.now += seconds
    assert timed.seconds == {"heads": 3.0}


def test_a_module_within_another_one_counts_once(clock: Clock) -> None:
    timed = Stopwatch()
    with timed("outer"):
        clock.now += 1
        with timed("inner"):
            clock.now += 2
            with timed("outer"):
                clock.now += 4
        clock.now += 8
    assert timed.seconds == {"outer": 13.0, "inner": 2.0}


def test_a_module_that_raises_is_measured_and_over(clock: Clock) -> None:
    timed = Stopwatch()

    def fail() -> None:
        with timed("outer"), timed("inner"):
            clock.now += 1
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fail()
    clock.now += 5
    with timed("after"):
        clock.now += 2
    assert timed.seconds == {"inner": 1.0, "outer": 0.0, "after": 2.0}


def test_modules_sum_to_no_more_than_what_passed() -> None:
    timed, start = Stopwatch(), time.perf_counter()
    for n in range(200):
        with timed(f"m{n % 7}"), timed(f"m{n % 5}"):
            sum(range(n))
    assert 0 < sum(timed.seconds.values()) <= time.perf_counter() - start
