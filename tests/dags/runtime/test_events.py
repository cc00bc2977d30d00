"""One stream of events: every kind has one JSON form, which is documented; the log and `--json` tell what happened."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.diagnostics.run_log import RunLog, stamped
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime import events
from posegaussian.dags.runtime.events import (
    Event,
    RunEnded,
    RunStarted,
    TaskDone,
    TaskFailed,
    TaskFresh,
    event_kinds,
    record,
)
from posegaussian.storage.archive.ledger import run_events
from posegaussian.storage.archive.receipts import Output, Receipt, ShardFile
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline

DOCS = Path(__file__).resolve().parents[3] / "docs/reference/ledger.md"
TASK = Task("kick", "depth", 3, None, None)
RECEIPT = Receipt(
    "depth",
    3,
    None,
    None,
    "f" * 32,
    {},
    (Output("depth/depth", 0, "d", (ShardFile("a", 7, 1), ShardFile("b", 5, 1))),),
    ("odd",),
    {"seconds": 2.5, "host": "h"},
)


def sample(kind: type) -> Event:
    """An event of a kind, by the types of its fields."""
    values: dict[str, Any] = {
        "Task": TASK,
        "Receipt": RECEIPT,
        "str": "words",
        "int": 2,
        "float": 1.5,
        "float | None": 1.5,
        "bool": False,
        "tuple[str, ...]": ("words",),
        "tuple[Task, ...]": (TASK, TASK),
    }
    return kind(**{f.name: values[str(f.type)] for f in dataclasses.fields(kind)})


every_kind = pytest.mark.parametrize("name", list(event_kinds()))


@every_kind
def test_every_event_is_plain_json_and_its_fields_are_those_of_the_docs(name: str) -> None:
    written = json.loads(json.dumps(record(sample(event_kinds()[name]))))
    assert written.pop("event") == name
    (row,) = [line.split("|") for line in DOCS.read_text().splitlines() if line.startswith(f"| `{name}` |")]
    documented = set(re.findall(r"`(\w+)`", row[3]))
    task = {"sequence", "stage", "partition", "view", "path"} if name.startswith("task_") else set()
    assert set(written) == documented | task


def test_the_docs_know_no_other_events() -> None:
    table = DOCS.read_text().partition("| event | when |")[2]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == list(event_kinds())


def test_a_finished_task_tells_bytes_warnings_and_facts() -> None:
    r = record(TaskDone(TASK, RECEIPT, ("never made",)))
    assert (r["bytes"], r["warnings"], r["seconds"], r["stage"], r["reasons"]) == (
        12,
        ["odd"],
        2.5,
        "depth",
        ["never made"],
    )
    assert set(events.FACTS) <= set(r)


def test_the_log_of_a_run_holds_every_event_but_the_fresh_ones(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "_runs/one")
    told: list[Event] = [
        RunStarted((TASK,), ()),
        TaskFresh(TASK),
        TaskFailed(TASK, "no disk", "trace"),
        RunEnded(0, 1, 1, 0, 0, 1.0, False),
    ]
    for event in told:
        log(event)
    ((name, found),) = run_events(Archive(tmp_path))
    assert name == "one"
    assert [e["event"] for e in found] == ["run_started", "task_failed", "run_ended"]
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+\+00:00", e["time"]) for e in found)


def test_a_log_that_a_kill_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    file = tmp_path / "_runs/one/events.jsonl"
    file.parent.mkdir(parents=True)
    file.write_text(stamped(TaskFresh(TASK)) + "\n" + stamped(TaskFresh(TASK))[:40])
    ((_, found),) = run_events(Archive(tmp_path))
    assert len(found) == 1


def lines(*arguments: str) -> list[dict[str, Any]]:
    """Standard output of a command, every line an object."""
    done = CliRunner().invoke(app, [*arguments])
    assert done.exit_code == 0, done.output
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_run_and_plan_write_nothing_but_events_for_machines(finished: Pipeline, tmp_path: Path) -> None:
    archive = finished.copy(tmp_path / "archive")
    common = ["--json", *archive.options]
    planned = [e for e in lines("plan", *common) if e["event"] == "task_planned"]
    assert len(planned) == len(archive.plan().verdicts)
    assert {e["state"] for e in planned} == {"fresh"}
    ran = lines("run", *common, "--scheduler", "serial", "--force", "metrics")
    assert (ran[0]["event"], ran[-1]["event"], ran[-1]["done"]) == ("run_started", "run_ended", 3)
    assert {e["sequence"] for e in ran if e["event"] == "task_done"} == {NAME}
    ((_, logged),) = run_events(Archive(archive.root))
    shared = [e["event"] for e in ran if e["event"] != "task_fresh"]
    assert [e["event"] for e in logged] == shared
