"""By the clock: bounds that any order of the jobs keeps, and partitions that are not alike."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posegaussian.dags.budget.clock import Tasks, clock
from posegaussian.dags.planning.tasks import Task

seconds = st.floats(0.0, 100.0)
sequences = st.lists(
    st.builds(
        lambda by_view, whole, chains: Tasks(by_view, whole, dict(enumerate(chains))),
        st.lists(seconds, max_size=5),
        seconds,
        st.lists(seconds, max_size=6),
    ),
    min_size=1,
    max_size=4,
)


@given(sequences, st.integers(1, 5))
def test_no_longer_than_one_after_the_other_and_no_shorter_than_any_order_allows(
    found: list[Tasks], workers: int
) -> None:
    total = sum(sum(s.by_view) + s.whole + sum(s.partitions.values()) for s in found)
    longest = max(max(s.by_view, default=0) + s.whole + max(s.partitions.values(), default=0) for s in found)
    took, rounding = clock(found, workers), 1e-9 * total
    assert max(total / workers, longest) - rounding <= took <= total + rounding
    if workers == 1:
        assert took == pytest.approx(total)


def test_the_longer_of_two_partitions_is_waited_for() -> None:
    """Twelve frames are partitions of eight and four: two workers take as long as the one with eight."""
    found = Tasks([1.0, 1.0], 10.0, {0: 80.0, 1: 40.0})
    assert clock([found], 1) == pytest.approx(132.0)
    assert clock([found], 2) == pytest.approx(1 + 10 + 80)
    assert clock([found], 8) == clock([found], 2), "no more workers than jobs"


def test_tasks_of_a_partition_are_one_job_and_those_of_the_whole_sequence_come_first() -> None:
    found = Tasks()
    for task, took in (
        (Task("walk", "survey", view=0), 2.0),
        (Task("walk", "survey", view=1), 3.0),
        (Task("walk", "judge"), 5.0),
        (Task("walk", "frames", 0, 0), 1.0),
        (Task("walk", "depth", 0), 7.0),
        (Task("walk", "depth", 1), 4.0),
    ):
        found.add(task, took)
    assert found == Tasks([2.0, 3.0], 5.0, {0: 8.0, 1: 4.0})


def test_sequences_are_worked_on_side_by_side() -> None:
    one = Tasks([10.0], 10.0, {0: 5.0})
    assert clock([one, one], 2) == pytest.approx(25)
    assert clock([one] * 4, 4) == pytest.approx(25)


def test_partitions_are_done_in_their_order() -> None:
    assert clock([Tasks(partitions={2: 30.0, 0: 10.0, 1: 10.0})], 2) == pytest.approx(40)
