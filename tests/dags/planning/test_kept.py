"""Going back to a setting takes over what was made with it: equal bytes, nothing computed, within a budget, whatever
dies in between."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from uuid import uuid4

import numpy as np
import pytest

from posegaussian.dags.maintenance import garbage_collection
from posegaussian.dags.planning.plan import TAKEN_OVER, Plan, State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime import scheduler
from posegaussian.dags.runtime.events import Event, RunEnded, TaskDone, TaskFailed
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.receipts import damaged_files, missing_files, scan_receipts
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film

ROOM = 10**9
OTHER = ("frames.size=32",)
"""Another setting: arrays of other lengths, so that the old ones are replaced."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """A small finished archive. Read it, do not change it."""
    folder = tmp_path_factory.mktemp("kept")
    film(folder / "person", views=3, frames=4)
    p = Pipeline(
        folder / "archive",
        folder / "person",
        [
            "depth.method=hull",
            *(f"effects.{e}=off" for e in ("silhouette_clipping", "hole_filling", "outline_evening")),
        ],
    )
    p.register()
    p.run()
    return p


@pytest.fixture
def a(made: Pipeline, tmp_path: Path) -> Pipeline:
    """A finished archive that may be changed."""
    return made.copy(tmp_path / "archive")


def run(
    p: Pipeline, room: int = ROOM, selection: Selection | None = None, names: tuple[str, ...] = (NAME,)
) -> tuple[int, int]:
    """(tasks that were computed, tasks that were taken over)."""
    selection = selection or Selection()
    events: list[Event] = []
    Run(
        [p.session.plan(name, selection) for name in names],
        selection,
        SerialBackend(),
        [events.append],
        rules=Rules(RunTerms(uuid4().hex, kept=room)),
    ).go()
    ended = next(e for e in events if isinstance(e, RunEnded))
    assert [e for e in events if isinstance(e, TaskFailed)] == []
    return sum(isinstance(e, TaskDone) for e in events), ended.taken


def of(known: dict[str, bytes | list], p: Pipeline) -> dict[str, bytes | list]:
    """What the archive holds of arrays that are known:
    other sizes have camera paths of other names, which stay beside."""
    return {k: v for k, v in content(p).items() if k in known}


def aside(p: Pipeline) -> list[set_aside.Entry]:
    return set_aside.entries(Archive(p.root))


def states(plan: Plan) -> set[State]:
    return {v.state for v in plan.verdicts.values()}


def test_there_and_back_computes_nothing_the_second_time_and_gives_the_same_bytes(a: Pipeline) -> None:
    first, b = content(a), a.with_settings(*OTHER)
    computed, taken = run(b)
    assert computed > 10
    assert taken == 0
    second = content(b)
    back = a.plan()
    assert states(back) <= {State.FRESH, State.KEPT}
    assert {r for v in back.verdicts.values() if v.state is State.KEPT for r in v.reasons} == {TAKEN_OVER}
    assert run(a)[0] == 0
    assert_same_content(of(first, a), first)
    assert a.plan().all_fresh
    assert run(b)[0] == 0
    assert_same_content(of(second, b), second)


def test_partitions_beyond_a_shorter_range_come_back_too(a: Pipeline) -> None:
    first = content(a)
    run(a.with_settings(*OTHER, "frames.range=0:2"))
    assert run(a)[0] == 0
    assert_same_content(of(first, a), first)


def test_what_is_aside_costs_no_bytes_until_the_sequence_s_own_is_replaced_and_keeps_to_the_budget(a: Pipeline) -> None:
    run(a.with_settings("rendering.sources=1"))
    every = sum(e.own for e in aside(a))
    assert every > 0
    run(a.with_settings("rendering.sources=3"), room=every)
    assert 0 < sum(e.own for e in aside(a)) <= every
    run(a.with_settings("rendering.sources=1"), room=0)
    assert sum(e.own for e in aside(a)) == 0


def test_a_run_without_a_budget_leaves_what_lies_aside(a: Pipeline) -> None:
    run(a.with_settings("rendering.sources=1"))
    before = {e.folder for e in aside(a)}
    a.with_settings("rendering.sources=3").run()
    assert {e.folder for e in aside(a)} == before


def several(p: Pipeline) -> tuple[str, ...]:
    """Two more sequences like the archive's; names of all three."""
    names = (NAME, "second", "third")
    for name in names[1:]:
        shutil.copytree(p.root / NAME, p.root / name)
        assert p.session.plan(name, Selection()).all_fresh
    return names


def test_however_many_sequences_there_are_what_lies_aside_is_looked_at_once_and_keeps_to_the_budget(
    a: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    names, looked = several(a), []
    plain = set_aside.entries
    monkeypatch.setattr(set_aside, "entries", lambda archive: looked.append(archive) or plain(archive))
    run(a.with_settings("rendering.sources=1"), names=names)
    assert len(looked) == 1
    every = aside(a)
    assert {e.folder.parent.name for e in every} == set(names)
    room = sum(e.own for e in every)
    run(a.with_settings("rendering.sources=3"), room=room, names=names)
    assert 0 < sum(e.own for e in aside(a)) <= room
    assert len(looked) == 4, "twice by this test"


def test_what_one_sequence_cannot_put_aside_stops_no_other(a: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    names, events = several(a), list[Event]()
    plain = scheduler.put_aside

    def refuse(plan: Plan, room: int) -> dict[Path, int]:
        if plan.context.sequence.name == "second":
            raise PermissionError("not there")
        return plain(plan, room)

    monkeypatch.setattr(scheduler, "put_aside", refuse)
    b = a.with_settings("rendering.sources=1")
    plans = [b.session.plan(name, Selection()) for name in names]
    rules = Rules(RunTerms(uuid4().hex, kept=ROOM))
    ended = Run(plans, Selection(), SerialBackend(), [events.append], rules=rules).go()
    assert {e.task.sequence for e in events if isinstance(e, TaskFailed)} == {"second"}
    assert {e.task.sequence for e in events if isinstance(e, TaskDone)} == {NAME, "third"}
    assert ended.failed == 1


def test_what_was_not_used_for_the_longest_time_goes_first(a: Pipeline) -> None:
    one, two = (a.with_settings(f"rendering.sources={n}") for n in (1, 3))
    run(one)
    size = sum(e.own for e in aside(a))
    run(two, room=round(1.5 * size))
    assert run(one, room=round(1.5 * size))[0] == 0, "used last"
    assert run(a, room=round(1.5 * size))[0] > 0, "used before"


def test_what_is_forced_is_made_anew_and_its_old_result_is_not_trusted(a: Pipeline) -> None:
    run(a.with_settings(*OTHER))
    assert run(a, selection=Selection(force=frozenset({"rendering"})))[0] == sum(
        t.stage == "rendering" for t in a.plan().verdicts
    )


def test_other_content_upstream_is_not_taken_over(a: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pictures come out otherwise when the run goes back: what was made of the old ones does not fit them."""
    from posegaussian.stages.imaging.warp import Warp

    sequence = Archive.open(str(a.root)).sequence(NAME)
    frames = [r for r in scan_receipts(sequence) if r.stage == "frames"]
    run(a.with_settings(*OTHER))
    for r in frames:
        set_aside.forget(sequence, set_aside.key_of(r), r.fingerprint)
    plain = Warp.__call__
    monkeypatch.setattr(
        Warp,
        "__call__",
        lambda self, picture: np.maximum(plain(self, picture), 3) if picture.ndim == 3 else plain(self, picture),
    )
    computed, _ = run(a)
    assert computed > sum(t.stage == "frames" for t in a.plan().verdicts), "and what reads them"
    assert a.plan().all_fresh


def test_a_damaged_result_is_computed_and_deleted(a: Pipeline) -> None:
    first = content(a)
    run(a.with_settings(*OTHER))
    for e in aside(a):
        file = e.folder / "0"
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.unlink()
        file.write_bytes(data)
    before = len(aside(a))
    computed, taken = run(a)
    assert taken == 0
    assert computed > 10
    assert_same_content(of(first, a), first)
    assert len(aside(a)) <= before, "the damaged ones went, the other setting's came"


@pytest.mark.parametrize(
    "where",
    [
        "posegaussian.storage.archive.set_aside.link_or_copy",
        "posegaussian.storage.archive.set_aside.write_receipt",
        "posegaussian.storage.archive.set_aside.os.link",
        "posegaussian.storage.archive.set_aside.os.rename",
    ],
)
def test_a_death_in_between_leaves_true_receipts_and_an_archive_that_goes_on(
    a: Pipeline, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    first, b = content(a), a.with_settings(*OTHER)
    putting = "os." in where
    if not putting:
        run(b)
    calls = [0]
    name = where.rpartition(".")[2]
    plain = getattr(os if putting else set_aside, name)

    def die(*args: object, **more: object) -> object:
        calls[0] += 1
        if calls[0] > 2:
            raise KeyboardInterrupt
        return plain(*args, **more)

    with monkeypatch.context() as m:
        m.setattr(set_aside, "os" if putting else name, SimpleNamespace(**{**vars(os), name: die}) if putting else die)
        Run(
            [(b if putting else a).plan()],
            Selection(),
            SerialBackend(),
            [],
            rules=Rules(RunTerms(uuid4().hex, kept=ROOM)),
        ).go()
    assert calls[0] > 2
    sequence = Archive.open(str(a.root)).sequence(NAME)
    whole = [r for r in scan_receipts(sequence) if not missing_files(sequence, r)]
    assert [f for r in whole for f in damaged_files(sequence, r)] == []
    run(a)
    assert_same_content(of(first, a), first)
    run(b)
    assert run(a)[0] == 0


def test_gc_shows_and_frees_them(a: Pipeline) -> None:
    run(a.with_settings(*OTHER))
    item = next(i for i in garbage_collection.items([a.plan()], Archive(a.root)) if i.kind == "variants")
    assert "results of other settings" in item.what
    assert item.bytes == sum(e.own for e in aside(a)) > 0
    garbage_collection.apply([item], [a.plan()])
    assert aside(a) == []


@pytest.mark.parametrize(
    ("text", "count"), [("0", 0), ("2GB", 2 * 10**9), ("1.5 MB", 1_500_000), ("700", 700), ("3kB", 3000)]
)
def test_the_budget_is_a_size(a: Pipeline, text: str, count: int) -> None:
    assert a.with_settings(f"run.keep_variants={text}").configuration.default.run.kept_bytes == count


def test_what_the_budget_does_not_hold_is_said_before_the_start(a: Pipeline) -> None:
    none = a.with_settings(*OTHER, "run.keep_variants=0")
    (sentence,) = none.session.disk_warnings([none.plan()])
    assert "will be deleted" in sentence
    assert "run.keep_variants is 0" in sentence
    enough = a.with_settings(*OTHER)
    assert enough.session.disk_warnings([enough.plan()]) == []
    assert enough.session.run_and_report([enough.plan()], Selection()) == 0
    assert states(a.plan()) <= {State.FRESH, State.KEPT}
    assert State.KEPT not in states(a.with_settings("run.keep_variants=0").plan())


def test_an_entry_that_a_kill_left_half_deleted_is_put_aside_again(a: Pipeline) -> None:
    sequence = Archive.open(str(a.root)).sequence(NAME)
    receipts = list(scan_receipts(sequence))[:3]
    assert set_aside.put(sequence, receipts)
    (set_aside.place_of(sequence, receipts[0]) / set_aside.ENTRY).unlink()
    assert set_aside.put(sequence, receipts)
    assert len(aside(a)) == 3
