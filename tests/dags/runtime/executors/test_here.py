"""A plan run in this process: what ran, what failed, and what ends it early."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.executors.inline_run import RunFailed, run_here
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.storage.archive.receipts import Receipt
from tests.support.pipeline import Pipeline, film

FRAMES = Selection(only=frozenset({"frames"}))
DEPTH = Selection(only=frozenset({"depth"}))


@pytest.fixture
def small(tmp_path: Path) -> Pipeline:
    """Three views and two frames, a task each."""
    film(tmp_path / "capture", views=3, size=32, frames=2, held_out=0)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", partition=1, held_out="[]")
    pipeline.register()
    return pipeline


def here(pipeline: Pipeline, **more: object) -> dict[Task, Receipt]:
    return run_here(pipeline.plan(selection=FRAMES), FRAMES, **more)  # type: ignore[arg-type]


def test_receipts_of_what_ran_and_nothing_of_what_was_fresh(small: Pipeline) -> None:
    first = here(small)
    assert sorted((t.stage, t.view, t.partition) for t in first) == [
        ("frames", v, p) for v in range(3) for p in range(2)
    ]
    assert all(r.facts["cpu_seconds"] >= 0 for r in first.values())
    assert here(small) == {}


def test_what_is_raised_after_a_task_ends_the_run_and_the_task_counts(small: Pipeline) -> None:
    def enough() -> None:
        raise TimeoutError

    for _ in range(2):
        with pytest.raises(TimeoutError):
            here(small, after_each=enough)
    assert len(here(small)) == 4


def test_workers_that_are_given_stay_for_the_next_plan_but_not_after_an_interrupt(small: Pipeline) -> None:
    closed = list[bool]()

    class Workers(SerialBackend):
        def close(self, hard: bool = False) -> None:
            closed.append(hard)

    workers = Workers()
    assert len(here(small, workers=workers)) == 6
    assert here(small, workers=workers) == {}
    assert closed == []

    def enough() -> None:
        raise KeyboardInterrupt

    run_here(small.plan(), Selection(only=frozenset({"survey"})), workers=workers)
    with pytest.raises(KeyboardInterrupt):
        run_here(small.plan(), DEPTH, after_each=enough, workers=workers)
    assert closed == [True]


def test_a_ctrl_c_is_answered_before_the_task_in_hand_ends(small: Pipeline) -> None:
    said = list[str]()

    def press() -> None:
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        here(small, after_each=press, say=said.append)
    assert said == ["stopping; what is finished is kept. Ctrl-C once more ends at once"]
    assert len(here(small)) == 5, "the task that was done counts"


def test_every_failed_task_is_named_and_the_others_are_done(small: Pipeline) -> None:
    (small.folder / "images" / "cam01" / "000000.png").write_bytes(b"no picture")
    with pytest.raises(
        RunFailed, match=r"^frames view 1 p0000: source file .* changed since it was imported"
    ) as caught:
        here(small)
    assert "p0001" not in str(caught.value)
    assert not getattr(caught.value, "__notes__", []), "the sentence says all that a user can do"
    states = [v.state for t, v in small.plan(selection=FRAMES).verdicts.items() if t.stage == "frames"]
    assert states.count(State.FRESH) == 5
