"""Tables fit the terminal: no header and no number is broken or cut."""

from __future__ import annotations

import re

import pytest
from rich.console import Console

from posegaussian.dags.diagnostics.run_log import FailedTask, failed_table
from posegaussian.dags.diagnostics.tables import MARKS, status_tables
from posegaussian.dags.maintenance import garbage_collection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import TaskFailed
from posegaussian.dags.runtime.failures import failures_table
from posegaussian.stages.registry import STAGES

COUNTS = {"all": 128, "done": 96, "failed": 3, "blocked": 12, "warned": 17, "stale": 0, "undecided": 0, "dropped": 0}


@pytest.mark.parametrize("width", [60, 80, 120, 300])
@pytest.mark.parametrize("name", ["kick", "a_very_long_name_of_a_sequence_from_the_archive_2026"])
def test_every_header_and_number_is_whole_at_any_width(width: int, name: str) -> None:
    standings = {f"{name}{i}": {s.name: dict(COUNTS) for s in STAGES} for i in range(3)}
    console = Console(width=width)
    with console.capture() as captured:
        for table in status_tables(standings, width):
            console.print(table)
    lines = captured.get().splitlines()
    words = re.findall(r"\S+", captured.get())
    assert max(map(len, lines)) <= width
    assert [w for w in words if w in {s.name for s in STAGES}] == [s.name for s in STAGES], (
        "each stage once, whole, in the order of flow"
    )
    assert words.count("96/128") == 3 * len(STAGES)
    assert captured.get().count("3f 12b 17w") == 3 * len(STAGES)
    assert all(mark for mark in MARKS.values())


def test_a_wide_terminal_needs_one_table() -> None:
    standings = {"kick": {s.name: dict(COUNTS) for s in STAGES}}
    assert len(status_tables(standings, 400)) == 1
    assert len(status_tables(standings, 80)) > 1


def test_names_in_brackets_are_shown_as_they_are() -> None:
    name, camera = "b[red]x", "cam[bold]1"
    task = Task(name, "frames", 0, 0, None)
    item = garbage_collection.Deletable("stages", name, "frames", 1, "nothing", lambda: None)
    console = Console(width=200)
    with console.capture() as captured:
        console.print(failed_table([FailedTask(task, "no disk", "2026-01-01T00:00:00", "run")]))
        console.print(failures_table([TaskFailed(task, "no disk", "")], [], {name: (camera,)}))
        console.print(garbage_collection.table([item], 200))
        for table in status_tables({name: {s.name: dict(COUNTS) for s in STAGES}}, 400):
            console.print(table)
    assert captured.get().count(name) == 4
    assert captured.get().count(camera) == 1
