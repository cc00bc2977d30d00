"""Progress is what the events say: every task settled once, failures told, no line without content."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from posegaussian.dags.diagnostics import progress
from posegaussian.dags.diagnostics.progress import QUIET_SECONDS, PlainProgress, TerminalProgress, WarningCollector
from posegaussian.dags.diagnostics.remaining_time import Remaining
from posegaussian.dags.humanize.text import Voice
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import (
    EffectsDecided,
    Event,
    RunEnded,
    RunStarted,
    TaskBlocked,
    TaskDone,
    TaskFailed,
    TaskFresh,
    TaskLeftOut,
    TaskStarted,
)
from posegaussian.storage.archive.receipts import Receipt

DEPTH = [Task("kick", "depth", p) for p in range(4)]
POSE = [Task("kick", "pose", p) for p in range(2)]
END = RunEnded(done=3, fresh=0, failed=1, blocked=0, left_out=0, seconds=1.0, interrupted=False)


def done(task: Task, seconds: float = 1.0, *warnings: str) -> TaskDone:
    return TaskDone(
        task,
        Receipt(task.stage, task.partition, task.view, task.path, "f", {}, (), warnings, {"seconds": seconds}),
        ("never made",),
    )


class Clock:
    now = 100.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock.now)
    return clock


def play(clock: Clock, *events: tuple[float, Event]) -> list[str]:
    lines: list[str] = []
    remaining = Remaining(dict.fromkeys((*POSE, *DEPTH), 20.0), workers=1)
    listener = PlainProgress(lines.append, remaining)
    for seconds, event in events:
        clock.now += seconds
        remaining(event)
        listener(event)
    return lines


def test_a_run_tells_its_sentences_and_when_each_stage_is_done(clock: Clock) -> None:
    lines = play(
        clock,
        (0, RunStarted((*POSE, *DEPTH), ("GPU work falls to the CPU.",))),
        (1, TaskStarted(POSE[0])),
        (0, done(POSE[0])),
        (1, done(POSE[1])),
        (1, done(DEPTH[0])),
        (0, END),
    )
    assert lines == ["GPU work falls to the CPU.", "pose: 2 of 2 done, 2.0 s"]


def test_a_failure_is_told_at_once_with_sequence_task_and_sentence(clock: Clock) -> None:
    lines = play(clock, (0, RunStarted(tuple(DEPTH), ())), (1, TaskFailed(DEPTH[2], "no disk", "traceback")))
    assert lines == ["failed: kick depth p0002: no disk"]


def test_a_long_stage_shows_its_count_and_the_time_left(clock: Clock) -> None:
    lines = play(
        clock,
        (0, RunStarted(tuple(DEPTH), ())),
        (0, TaskStarted(DEPTH[3])),
        (20, done(DEPTH[0], 20.0)),
        (20, done(DEPTH[1], 20.0)),
    )
    assert lines == ["25% done, about 60.0 s left; depth 1/4", "50% done, about 40.0 s left; depth 2/4"]


def test_between_two_lines_there_is_quiet(clock: Clock) -> None:
    many = [Task("kick", "depth", p) for p in range(100)]
    lines = play(clock, (0, RunStarted(tuple(many), ())), *((1.0, done(t)) for t in many[:-1]))
    assert len(lines) <= 99 / QUIET_SECONDS + 1


@pytest.mark.parametrize("settle", [TaskFresh, TaskLeftOut, lambda t: TaskBlocked(t, POSE[0])])
def test_no_line_is_empty_when_a_stage_ends_without_work(clock: Clock, settle: object) -> None:
    lines = play(clock, (0, RunStarted((*POSE, *DEPTH), ())), *((QUIET_SECONDS + 1, settle(t)) for t in POSE))  # type: ignore[operator]
    assert all(line.strip() for line in lines), lines


def test_one_bar_counts_every_settled_task_whatever_became_of_it() -> None:
    out = io.StringIO()
    remaining = Remaining(dict.fromkeys((*POSE, *DEPTH), 1.0), workers=1)
    listener = TerminalProgress(Console(file=out, force_terminal=True, width=100), remaining)
    events: list[Event] = [
        RunStarted((*POSE, *DEPTH), ("a sentence",)),
        TaskFresh(POSE[0]),
        done(POSE[1]),
        done(DEPTH[0]),
        TaskFailed(DEPTH[1], "no [disk]", ""),
        TaskBlocked(DEPTH[2], DEPTH[1]),
        TaskLeftOut(DEPTH[3]),
        END,
    ]
    for event in events:
        remaining(event)
        listener(event)
    assert [(t.completed, t.total) for t in listener.bars.tasks] == [(1.0, 1.0)]
    assert (listener.tally.counts, listener.tally.lost["depth"]) == ({"pose": 2, "depth": 4}, 3)
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", out.getvalue())
    assert "a sentence" in text
    assert "failed: kick depth p0001: no [disk]" in text, "brackets of an error are no markup"


def test_sentences_with_brackets_are_shown_as_they_are() -> None:
    out = io.StringIO()
    listener = TerminalProgress(Console(file=out, width=200), Remaining({}, workers=1))
    listener(RunStarted((), ("sequence kick: views.sources [cam01] gives one view; see [/home/x]",)))
    listener(END)
    assert "views.sources [cam01] gives one view; see [/home/x]" in out.getvalue()


def test_warnings_and_failures_are_collected_with_their_task() -> None:
    collector = WarningCollector()
    for event in [
        RunStarted(tuple(DEPTH), ()),
        done(DEPTH[0], 1.0, "odd", "even"),
        TaskFailed(DEPTH[1], "no disk", "trace"),
        END,
    ]:
        collector(event)
    assert collector.warnings == ["kick depth p0000: odd", "kick depth p0000: even"]
    assert [f.task for f in collector.failures] == [DEPTH[1]]


def test_what_is_said_of_several_cameras_alike_is_said_once() -> None:
    collector, views = WarningCollector(), [Task("kick", "survey", view=v) for v in range(3)]
    for task, camera in zip(views, ("cam00", "cam01", "cam02"), strict=True):
        collector(
            done(task, 1.0, f"{camera}: only 2 frames", *([f"{camera}: not static"] if camera == "cam01" else []))
        )
    collector(done(DEPTH[0], 1.0, "odd: even"))
    assert collector.warning_sentences() == [
        "kick survey: cam00 and 2 more cameras: only 2 frames",
        "kick survey: cam01: not static",
        "kick depth p0000: odd: even",
    ]
    assert len(collector.warnings) == 5, "the log has every one"


@pytest.mark.parametrize(("voice", "lines"), [(Voice.NORMAL, 1), (Voice.VERBOSE, 3)])
def test_effects_take_one_line_unless_every_reason_is_asked_for(voice: Voice, lines: int) -> None:
    told: list[str] = []
    event = EffectsDecided("kick", ("a on (auto): x", "b off (auto): y", "c off (auto): z"), ("a",), ("b", "c"))
    options = ("--archive", "an archive", "--set", "frames.size=64")
    PlainProgress(told.append, Remaining({}, 1), voice, options)(event)
    assert len(told) == lines
    asking = "(why: posegaussian plan -v --archive 'an archive' --set frames.size=64)"
    assert told[0].endswith(asking) == (voice is Voice.NORMAL), "what the reasons are asked with can be pasted"
    assert all(any(name in line for line in told) for name in "abc"), "every effect is named"
