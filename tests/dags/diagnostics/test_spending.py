"""What modules took, as sentences: shares of the whole task, small ones among the rest,
tasks that say nothing left out."""

from __future__ import annotations

from posegaussian.dags.diagnostics.profile import Spending
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import TaskDone, TaskStarted
from posegaussian.storage.archive.receipts import Receipt


def done(stage: str, partition: int, **facts: object) -> TaskDone:
    return TaskDone(
        Task("kick", stage, partition), Receipt(stage, partition, None, None, "f", {}, (), (), facts), ("never made",)
    )


def test_shares_are_of_all_tasks_together_dearest_first() -> None:
    spending = Spending()
    spending(TaskStarted(Task("kick", "network", 0)))
    spending(done("network", 0, seconds=30.0, modules={"heads": 3.0, "refinement": 12.0, "fusion": 0.1}))
    spending(done("network", 1, seconds=10.0, modules={"heads": 3.0, "refinement": 4.0, "reading": 2.0}))
    assert spending.sentences() == ["network took 40.0 s in 2 tasks: refinement 40%, heads 15%, reading 5%, rest 40%"]


def test_what_says_nothing_of_its_modules_is_left_out() -> None:
    spending = Spending()
    for event in (done("depth", 0, seconds=2.0), done("network", 0, seconds=2.0, modules={}), done("network", 1)):
        spending(event)
    assert spending.sentences() == []


def test_every_stage_has_its_own_sentence() -> None:
    spending = Spending()
    spending.add("network", 2.0, {"heads": 2.0})
    spending.add("depth", 4.0, {"sweep": 3.0})
    assert spending.sentences() == [
        "network took 2.0 s in 1 task: heads 100%, rest 0%",
        "depth took 4.0 s in 1 task: sweep 75%, rest 25%",
    ]
