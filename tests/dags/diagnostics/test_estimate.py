"""What is left of a run: expectations before the start, the run's own pace afterwards."""

from __future__ import annotations

import pytest

from posegaussian.dags.diagnostics import remaining_time
from posegaussian.dags.diagnostics.remaining_time import Remaining
from posegaussian.dags.planning.forecast import History
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import Event, RunStarted, TaskDone, TaskFailed, TaskFresh, TaskNeeded
from posegaussian.storage.archive.receipts import Receipt
from tests.support.pipeline import Pipeline

TASKS = [Task("kick", stage, p) for stage in ("depth", "rendering") for p in range(4)]
EXPECTED = {t: 10.0 if t.stage == "depth" else 1.0 for t in TASKS}


class Clock:
    now = 0.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(remaining_time.time, "monotonic", lambda: clock.now)
    return clock


def done(task: Task, seconds: float) -> TaskDone:
    return TaskDone(
        task,
        Receipt(task.stage, task.partition, task.view, task.path, "f", {}, (), (), {"seconds": seconds}),
        ("never made",),
    )


def heard(remaining: Remaining, *events: Event) -> Remaining:
    for event in (RunStarted(tuple(TASKS), ()), *events):
        remaining(event)
    return remaining


def test_before_the_start_the_work_is_shared_by_the_workers() -> None:
    assert Remaining(EXPECTED, workers=2).seconds_before == 22.0


def test_no_run_is_shorter_than_its_longest_task() -> None:
    assert Remaining({TASKS[0]: 10.0}, workers=2).seconds_before == 10.0


def test_a_run_whose_tasks_take_what_was_expected_ends_when_it_was_expected(clock: Clock) -> None:
    remaining = heard(Remaining(EXPECTED, workers=1))
    for task in TASKS:
        clock.now += EXPECTED[task]
        remaining(done(task, EXPECTED[task]))
        assert clock.now + remaining.seconds_left == pytest.approx(44.0)
        assert remaining.share_done == pytest.approx(clock.now / 44.0)


def test_what_tasks_take_is_believed_the_more_of_them_are_done(clock: Clock) -> None:
    """Twice the time expected: the rest of the stage is expected to take more,
    and at last nearly twice as much, too."""
    remaining, left = heard(Remaining(EXPECTED, workers=1)), []
    for task in TASKS[:3]:
        clock.now += 20.0
        remaining(done(task, 20.0))
        left.append(remaining._factor("depth"))
    assert 1 < left[0] < left[1] < left[2] < 2


@pytest.mark.parametrize("settle", [TaskFresh, lambda t: TaskFailed(t, "no disk", "")])
def test_what_need_not_run_takes_nothing(clock: Clock, settle: object) -> None:
    remaining = heard(Remaining(EXPECTED, workers=1), *(settle(t) for t in TASKS[:4]))  # type: ignore[operator]
    assert remaining.seconds_left == pytest.approx(4.0)
    assert remaining.share_done == 0.0


def test_a_task_that_is_needed_after_all_counts_again(clock: Clock) -> None:
    remaining = heard(Remaining(EXPECTED, workers=1), TaskFresh(TASKS[0]), TaskNeeded(TASKS[0], TASKS[1]))
    assert remaining.seconds_left == pytest.approx(44.0)


def test_nothing_to_do_is_all_or_nothing_done_but_never_a_division_by_zero(clock: Clock) -> None:
    remaining = heard(Remaining({}, workers=1))
    assert (remaining.seconds_left, remaining.share_done) == (0.0, 0.0)


def test_without_history_it_is_called_a_guess(finished: Pipeline) -> None:
    changed = finished.with_settings("pose.sigma=0.05")
    plan = changed.plan()
    assert "a guess" in Remaining.of([plan], History(), 1).sentence
    known = Remaining.of([plan], finished.session.history, 1)
    assert known.expected.keys() == {t for t, v in plan.verdicts.items() if v.state.value != "fresh"}


def test_stages_that_a_run_may_not_touch_take_nothing(finished: Pipeline) -> None:
    changed = finished.with_settings("pose.sigma=0.05")
    whole = Remaining.of([changed.plan()], History(), 1)
    alone = Remaining.of([changed.plan(selection=Selection(only=frozenset({"pose"})))], History(), 1)
    assert {t.stage for t in alone.expected} == {"pose"} < {t.stage for t in whole.expected}
    assert alone.expected.items() <= whole.expected.items()
    assert not Remaining.of([changed.plan(selection=Selection(only=frozenset({"survey"})))], History(), 1).expected
