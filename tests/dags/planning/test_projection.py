"""What a run is expected to take: bytes that are written, memory that is taken, seconds from history;
refusal before the start."""

from __future__ import annotations

import errno
import io
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from posegaussian.dags.diagnostics.tables import projection_table
from posegaussian.dags.planning import forecast
from posegaussian.dags.planning.forecast import Disk, History, project
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.resources import local_pools, refusals
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.task_cost import RESERVED, load, needs_of, work
from posegaussian.dags.planning.tasks import Task, tasks
from posegaussian.dags.runtime import meters
from posegaussian.dags.runtime.meters import Peak
from posegaussian.stages.refinement.stage import REHEARSAL
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.ledger import rebuild
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError, NotWritten
from tests.support.pipeline import NAME, Pipeline

FRAMES, POSE = stage_named("frames"), stage_named("pose")


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive with its ledger."""
    copy = finished.copy(tmp_path / "archive")
    rebuild(Archive.open(str(copy.root)))
    return copy


def history(pipeline: Pipeline) -> History:
    return History.read(Archive.open(str(pipeline.root)))


def disk(pipeline: Pipeline, plan: Plan, known: History) -> Disk:
    return Disk.of([plan], Archive(pipeline.root), known)


def leave_free(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    """Have every disk so many bytes free."""
    usage = shutil.disk_usage(Path.cwd())
    monkeypatch.setattr(forecast.shutil, "disk_usage", lambda _: usage._replace(free=free))


def test_projected_bytes_are_those_of_the_blocks_that_are_written(finished: Pipeline) -> None:
    """Without history bytes are uncompressed: exactly what the arrays of the finished archive hold."""
    import zarr

    plan = finished.plan()
    for stage in STAGES:
        done = [t for t in tasks(plan.context) if t.stage == stage.name]
        if not done or stage.name == "metrics":
            continue
        arrays = {o.array for t in done for o in plan.book.receipts[t].outputs}
        views = len(plan.context.active_views)
        whole = [zarr.open_array(finished.root / NAME / a, mode="r") for a in arrays]
        held = (
            sum(
                a.nbytes // (a.shape[1] if "view" in stage.over else 1) * (views if "view" in stage.over else 1)
                for a in whole
            )
            if "time" in stage.over
            else None
        )
        if held is not None:
            assert sum(load(plan.context, t).raw_bytes for t in done) == held, stage.name
        for t in done:
            assert plan.book.receipts[t].facts["raw_bytes"] == load(plan.context, t).raw_bytes


def test_history_turns_bytes_and_work_into_disk_and_seconds(archive: Pipeline) -> None:
    plan = archive.plan(selection=Selection(start="frames"))
    found = {p.stage: p for p in project(plan, history(archive))}
    assert set(found) == {t.stage for t, v in plan.verdicts.items() if v.state is not State.FRESH}
    for stage, p in found.items():
        receipts = [r for t, r in plan.book.receipts.items() if t.stage == stage]
        on_disk = sum(f.size for r in receipts for o in r.outputs for f in o.files)
        assert p.replaced == on_disk
        if stage != "metrics":  # tables have no projected size
            assert p.compressed
            # The same tasks again: the ratio gives back what they took, up to rounding.
            assert p.disk == pytest.approx(on_disk, rel=1e-3, abs=2)
        assert p.timed == "same settings"
        assert p.seconds == pytest.approx(sum(r.facts["seconds"] for r in receipts), rel=1.0), (
            "a median stands for the mean"
        )


def test_without_history_typical_rates_stand_in_and_are_called_a_guess(archive: Pipeline) -> None:
    plan = archive.plan(selection=Selection(start="frames"))
    with_history = {p.stage: p for p in project(plan, history(archive))}
    guesses = project(plan, History())
    for p in guesses:
        typical = next(s for s in STAGES if s.name == p.stage).typical
        loads = [load(plan.context, t) for t in plan.to_make if t.stage == p.stage]
        assert (p.timed, p.compressed) == ("guess", False)
        assert p.seconds == pytest.approx(typical.seconds * sum(of_task.work for of_task in loads))
        assert p.disk == pytest.approx(typical.ratio * sum(of_task.raw_bytes for of_task in loads), abs=1)
    assert _shown(guesses).count("(guess)") == 2 * len(guesses) + 2 - sum(not p.disk for p in guesses)
    assert "(guess)" not in _shown(list(with_history.values()))
    assert _shown(guesses).count("\n") == _shown(list(with_history.values())).count("\n")


def _shown(projections: list[forecast.Projection]) -> str:
    out = io.StringIO()
    Console(width=120, file=out).print(projection_table(projections))
    return out.getvalue()


def test_typical_rates_are_declared_by_every_stage() -> None:
    for stage in STAGES:
        assert 0 < stage.typical.seconds < 1e-3, stage.name
        assert 0 < stage.typical.ratio <= 1, stage.name


def test_nothing_is_projected_of_stages_that_a_run_may_not_touch(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Pipeline(archive.root.with_name("first"), archive.folder)
    first.register()
    plan = first.plan(selection=Selection(only=frozenset({"pose"})))
    known = history(archive)
    (pose,) = project(plan, known)
    assert pose.stage == "pose"
    leave_free(monkeypatch, pose.disk)
    assert disk(first, plan, known).refusals() == []
    assert disk(first, first.plan(), known).refusals()
    little = first.with_settings(f"run.memory={needs_of(plan.context, POSE).ram / 2**20 + 0.001}")
    pools = local_pools(little.configuration.default.run)
    assert refusals([little.plan(selection=plan.selection)], pools) == []
    assert refusals([little.plan()], pools)


def test_what_may_turn_out_not_to_run_is_no_reason_to_refuse(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Pipeline(archive.root.with_name("first"), archive.folder, ["effects.temporal_smoothing=auto"])
    first.register()
    plan, known = first.plan(), history(archive)
    needs = {p.stage: p.peak for p in project(plan, known) if p.compressed}
    assert plan.context.perhaps_unneeded & needs.keys() == {"smoothing"}
    assert needs["smoothing"] > 0
    certain = sum(needs.values()) - needs["smoothing"]
    for free, refused in ((certain, False), (certain - 1, True)):
        leave_free(monkeypatch, free)
        assert bool(disk(first, plan, known).refusals()) == refused


def test_work_on_captured_pictures_is_the_same_at_every_size_that_is_worked_on(archive: Pipeline) -> None:
    whole, half = archive.context(), archive.with_settings("frames.size=24").context()
    for name, share in (("detection", 1.0), ("survey", 1.0), ("frames", (0.25 + 0.1) / 1.1), ("depth", 0.25)):
        view = 0 if name in ("survey", "frames") else None
        task = Task(NAME, name, None if name == "survey" else 0, view)
        assert work(half, task, 2) == pytest.approx(share * work(whole, task, 2), rel=1e-3), name


def test_a_rehearsal_is_work_that_a_longer_partition_has_no_more_of(archive: Pipeline) -> None:
    context, task = archive.with_settings("refinement.steps=2").context(), Task(NAME, "refinement", 0)
    two, eight = work(context, task, 2), work(context, task, 8)
    assert eight / two == pytest.approx((8 + REHEARSAL) / (2 + REHEARSAL), rel=1e-4), "but for whole pixels"
    depth = Task(NAME, "depth", 0)
    assert work(context, depth, 8) == 4 * work(context, depth, 2)


def test_seconds_of_work_that_was_counted_otherwise_are_not_compared(archive: Pipeline) -> None:
    rows = history(archive).timed
    assert {row["unit"] for row in rows if row["stage"] == "frames"} == {"1 worked + 0.1 captured"}
    older = History([{**row, "unit": None if row["stage"] == "frames" else row["unit"]} for row in rows])
    params = archive.context().params(FRAMES)
    was, now = older.rate(FRAMES, params), history(archive).rate(FRAMES, params)
    assert (was.timed, was.seconds) == ("guess", FRAMES.typical.seconds)
    assert (now.timed, was.ratio, was.compressed) == ("same settings", now.ratio, True)
    assert {row["stage"] for row in older.timed} == {row["stage"] for row in rows} - {"frames"}


def test_seconds_of_other_settings_are_marked_and_work_scales_them(archive: Pipeline) -> None:
    changed = archive.with_settings("depth.pairs=1")
    depth = next(p for p in project(changed.plan(), history(archive)) if p.stage == "depth")
    assert depth.timed == "other settings"
    half = archive.with_settings("frames.size=24")
    before = next(
        p for p in project(archive.plan(selection=Selection(start="frames")), history(archive)) if p.stage == "depth"
    )
    after = next(p for p in project(half.plan(), history(archive)) if p.stage == "depth")
    assert after.seconds == pytest.approx(before.seconds / 4, rel=1e-6), "a quarter of the pixels"


def test_letting_go_lowers_the_projected_peak_of_long_sequences(archive: Pipeline) -> None:
    short = archive.with_settings("run.keep=as_declared", "run.workers=1", "run.window=1", "run.scheduler=local")
    longer = Pipeline(archive.root.with_name("fine"), archive.folder, short.settings, partition=1)
    longer.register()
    frames = {
        k: next(p for p in project(longer.with_settings(f"run.keep={k}").plan(), History()) if p.stage == "frames")
        for k in ("everything", "as_declared")
    }
    assert frames["everything"].peak == frames["everything"].disk == frames["as_declared"].disk
    # frames/color is 3 of the 8 bytes a pixel (mask 1, true depth 4); of six partitions three are there at a time.
    assert frames["as_declared"].peak == pytest.approx(frames["everything"].disk * (1 - 3 / 8 * 3 / 6))


def test_a_task_too_large_for_a_worker_is_refused_with_what_to_change(archive: Pipeline) -> None:
    again = archive.with_settings("gaussians.footprint=0.6")
    need = max(
        needs_of(again.context(), s, p).ram
        for s in STAGES
        if s.name in ("gaussians", "rendering", "metrics")
        for p in again.context().paths
    )
    assert need > RESERVED
    enough = again.with_settings(f"run.memory={need / 2**20 + 1}")
    assert refusals([enough.plan()], local_pools(enough.configuration.default.run)) == []
    little = again.with_settings(f"run.memory={need / 2**20 - 0.01}")
    (sentence,) = refusals([little.plan()], local_pools(little.configuration.default.run))
    assert "rendering of sequence person needs about" in sentence
    assert "posegaussian reshard person --frames 1" in sentence
    assert "frames.size" in sentence
    with pytest.raises(ConfigError, match="rendering of sequence person"):
        little.session.run_and_report([little.plan()], Selection())


def test_the_judge_needs_less_of_smaller_pictures_and_no_more_of_larger_ones_but_to_read_one() -> None:
    """It draws pictures of `judge.size` at most."""
    judge = stage_named("judge")
    params = judge.params()

    def ram(side: int) -> int:
        return judge.needs({"view": 8} | dict.fromkeys(("x", "y", "source_x", "source_y"), side), params).ram

    own, quarter, large = (ram(side) for side in (params.size, params.size // 2, 4 * params.size))
    assert quarter - 2**28 == pytest.approx((own - 2**28) / 4, rel=1e-6)
    assert large - own == pytest.approx(15 * params.size**2 * 60, rel=1e-6)


def test_more_bytes_than_the_disk_has_are_refused_before_the_start(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = archive.plan(selection=Selection(start="frames"))
    assert disk(archive, plan, history(archive)).refusals() == [], "what is replaced makes room"
    leave_free(monkeypatch, 1000)
    shutil.rmtree(archive.root / NAME)
    archive.register()  # the ledger still says what its tasks took
    with pytest.raises(
        ConfigError,
        match=r"the run is projected to need .* more on disk, .* has 1.0 kB free; set run.keep to as_declared",
    ):
        archive.session.run_and_report([archive.plan()], Selection())
    assert not list((archive.root / NAME / "_receipts").rglob("*.json"))


def test_a_guess_of_what_the_disk_lacks_is_a_warning_and_the_run_goes_on(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first = Pipeline(archive.root.with_name("first"), archive.folder)
    first.register()
    leave_free(monkeypatch, 1000)
    only = Selection(only=frozenset({"frames"}))
    plan = first.plan(selection=only)
    assert disk(first, plan, history(archive)).refusals(), "the same, measured"
    assert disk(first, plan, history(archive)).doubts() == [], "what is refused is not doubted, too"
    assert first.session.refusals([plan]) == []
    (told,) = first.session.disk_warnings([plan])
    assert re.match(
        r"the run may need (.*B) more on disk, of which \1 are a guess, and .* has 1\.0 kB free: a run of a few frames"
        r" \(--set frames\.range=0:16\) measures it",
        told,
    )
    loud = replace(first.session, console=Console(width=400))
    assert loud.run_and_report([plan], only) == 0
    assert told in capsys.readouterr().out
    assert list((first.root / NAME / "_receipts").rglob("*.json"))


@pytest.mark.parametrize(("free", "refused", "doubted"), [(9, True, False), (10, False, True), (29, False, True)])
def test_guesses_never_add_to_what_is_refused(free: int, refused: bool, doubted: bool) -> None:
    room = Disk(10, 20, free, Path("archive"))
    assert (bool(room.refusals()), bool(room.doubts())) == (refused, doubted)
    assert Disk(10, 20, 30, Path("archive")).doubts() == []
    assert Disk(10, -5, 5, Path("archive")).refusals() == [], "what is replaced makes room"


def test_a_place_that_cannot_be_written_is_told_and_not_what_its_disk_lacks(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Pipeline(archive.root.with_name("first"), archive.folder)
    first.register()
    sequence = first.root / NAME

    def refused(dir: Path) -> io.BytesIO:
        if dir == sequence:  # the archive's folder is ours, the sequence's another user's
            raise PermissionError(errno.EACCES, "Permission denied", str(dir / "tmp"))
        return io.BytesIO()

    leave_free(monkeypatch, 1000)
    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    (told,) = first.session.refusals([first.plan()])
    assert told.startswith(f"cannot write {sequence}: there is no permission to write in {sequence};"), "a plan's word"
    with pytest.raises(NotWritten, match=re.escape(told)):
        first.session.run_and_report([first.plan()], Selection())


def test_where_nothing_is_to_do_nothing_needs_to_be_written(
    finished: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(dir: Path) -> io.BytesIO:
        raise PermissionError(errno.EACCES, "Permission denied", str(dir / "tmp"))

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    assert finished.session.refusals([finished.plan()]) == []
    assert finished.session.refusals([finished.with_settings("depth.pairs=1").plan()])


def test_receipts_carry_projected_beside_measured_memory(finished: Pipeline) -> None:
    for receipt in finished.plan().book.receipts.values():
        facts = receipt.facts
        assert facts["projected_ram"] > RESERVED
        assert facts["peak_rss"] > 2**26, "an interpreter with numpy has more than 64 MB"
        assert facts["work"] > 0


@pytest.mark.parametrize("record", ["kernel", "samples"])
def test_the_peak_is_the_block_s_own_not_the_process_s(
    record: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if record == "samples":
        monkeypatch.setattr(meters, "CLEAR", tmp_path / "no" / "such" / "file")
    elif not meters.CLEAR.exists():
        pytest.skip("this system does not let a process reset its peak")
    size = 150 * 2**20

    def peak_of(count: int) -> int:
        with Peak() as peak:
            a = np.ones(count // 8)
            for _ in range(3):
                a += 1
            import time

            time.sleep(3 * meters.SAMPLE_SECONDS)
        return peak.bytes

    large, small = peak_of(size), peak_of(2**20)
    # A large block leaves no trace in the next one's peak; 20 MB for what the allocator keeps.
    assert large - small > size - 20 * 2**20
