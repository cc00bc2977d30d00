"""Dropping what nobody needs any more:
results are equal whichever policy, and what is needed again is made again, alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics.status import numbers
from posegaussian.dags.diagnostics.tables import plan_table, status_tables
from posegaussian.dags.export.pictures import needed, write_exports
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.retention import policy
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import PRODUCERS
from posegaussian.dags.runtime.events import Event, TaskDone, TaskNeeded
from posegaussian.dags.runtime.eviction import Keeper
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.storage.archive.deletion import folder_bytes
from posegaussian.storage.model.errors import ConfigError, ShardMissing
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, receipts

DROP = "run.keep=as_declared"
UNTIL_DONE = {"frames/color", "gaussians/scale", "gaussians/rotation", "gaussians/opacity"}
"""What the declarations call until_done and another stage reads; nobody reads heatmaps, which are asked for by name."""


@pytest.fixture(scope="module")
def dropping(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, int]:
    """The finished archive after a run that drops what it may, and the most bytes the sequence took.
    Read it, do not change it."""
    pipeline = Pipeline(tmp_path_factory.mktemp("dropping") / "archive", finished.folder, [DROP])
    pipeline.register()
    peak = 0

    def weigh(event: Event) -> None:
        nonlocal peak
        peak = max(peak, folder_bytes(pipeline.root / NAME))

    plan = pipeline.plan()
    ended = Run([plan], Selection(), SerialBackend(), [Keeper([plan]), weigh]).go()
    assert (ended.failed, ended.blocked) == (0, 0)
    return pipeline, peak


@pytest.fixture
def dropped(dropping: tuple[Pipeline, int], tmp_path: Path) -> Pipeline:
    """A copy of the archive with dropped outputs that may be changed."""
    return dropping[0].copy(tmp_path / "archive")


def shards(pipeline: Pipeline, array: str) -> list[Path]:
    return list((pipeline.root / NAME / array).glob("c.*"))


def dropped_arrays(plan: Plan) -> set[str]:
    return {o.array for r in plan.book.receipts.values() for o in r.outputs if o.dropped}


def test_results_are_equal_whichever_policy(dropping: tuple[Pipeline, int], finished: Pipeline) -> None:
    pipeline, _ = dropping
    assert receipts(pipeline) == receipts(finished), "the receipts keep fingerprints and digests of what was dropped"
    assert_same_content(content(pipeline, but=tuple(UNTIL_DONE)), content(finished, but=tuple(UNTIL_DONE)))
    # Pictures are read by rendering and, of held-out views, by metrics; maps that nobody reads are results and stay.
    plan = pipeline.plan()
    assert dropped_arrays(plan) == UNTIL_DONE
    assert shards(pipeline, "gaussians/confidence"), "nobody reads it: it is a result"
    assert not [p for a in UNTIL_DONE for p in shards(pipeline, a)]


def test_the_most_bytes_on_disk_are_fewer(dropping: tuple[Pipeline, int], finished: Pipeline) -> None:
    pipeline, peak = dropping
    whole = folder_bytes(finished.root / NAME)
    assert folder_bytes(pipeline.root / NAME) < 0.75 * whole
    assert peak < 0.9 * whole, "the peak comes from one partition's arrays, not from all"


def test_dropped_counts_as_fresh_and_is_shown(dropping: tuple[Pipeline, int], render: Callable[[object], str]) -> None:
    pipeline, _ = dropping
    plan = pipeline.plan()
    assert plan.all_fresh
    assert plan.dropped("frames") == plan.counts("frames")[State.FRESH] == 21
    assert plan.dropped("depth") == 0
    assert "dropped" in render(plan_table(plan))
    assert "21d" in "".join(render(t) for t in status_tables({NAME: numbers(plan)}, 220))
    assert pipeline.ran() == {}


@pytest.fixture
def render() -> Callable[[object], str]:
    from rich.console import Console

    def as_text(table: object) -> str:
        console = Console(width=220)
        with console.capture() as captured:
            console.print(table)
        return captured.get()

    return as_text


def test_another_path_makes_again_just_what_it_reads(dropped: Pipeline) -> None:
    plan = dropped.plan("orbit")
    reason = "its output was dropped and is needed by rendering"
    assert {v.task.stage: set(v.reasons) for v in plan.verdicts.values() if v.state is State.STALE} == {
        "frames": {reason},
        "gaussians": {reason},
        "rendering": {"never made"},
    }
    # Six source views of three partitions; of the held-out view nothing is rendered from.
    assert dropped.ran("orbit") == {"frames": 18, "gaussians": 3, "rendering": 3}
    assert dropped.plan("orbit").all_fresh
    assert dropped_arrays(dropped.plan("orbit")) == UNTIL_DONE, "and it is dropped again afterwards"


def test_a_stale_stage_calls_back_and_equal_content_stops_there(dropped: Pipeline) -> None:
    # depth reads pictures; it comes out equal, so neither gaussians nor rendering need what was dropped of them.
    assert dropped.ran(selection=Selection(force=frozenset({"depth"}))) == {"frames": 18, "depth": 3}


def test_what_only_an_undecided_stage_reads_is_not_made_again_in_vain(dropped: Pipeline) -> None:
    plan = dropped.plan(selection=Selection(force=frozenset({"gaussians"})))
    assert plan.counts("frames") == {State.UNDECIDED: 21}, (
        "rendering may need the pictures, and metrics the held-out ones"
    )
    assert dropped.ran(selection=Selection(force=frozenset({"gaussians"}))) == {"gaussians": 3}


def test_a_changed_setting_runs_through(dropped: Pipeline, finished: Pipeline, tmp_path: Path) -> None:
    counts = dropped.with_settings("gaussians.footprint=0.6").ran()
    assert counts == {
        "gaussians": 3,
        "frames": 18 + 3,
        "rendering": 3,
        "metrics": 3,
    }, "metrics reads the held-out pictures"
    kept = finished.copy(tmp_path / "kept").with_settings("gaussians.footprint=0.6")
    kept.run()
    assert_same_content(content(dropped, but=tuple(UNTIL_DONE)), content(kept, but=tuple(UNTIL_DONE)))


def test_only_blocks_what_would_need_another_stage(dropped: Pipeline) -> None:
    events = dropped.run("orbit", selection=Selection(only=frozenset({"rendering"})), expect_failure=True)
    assert not [e for e in events if isinstance(e, TaskDone)]
    assert {e.by.stage for e in events if type(e).__name__ == "TaskBlocked"} == {"frames"}


def test_content_that_comes_out_different_reaches_those_that_were_fresh(
    dropped: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kernel that is not the same twice (another device, another library):
    nothing may stay fresh over the old bytes."""
    import posegaussian.stages.frames.run as frames
    from posegaussian.stages.contract.io import Block

    real = frames.run

    def brighter(inputs: object, params: object) -> object:
        for block in real(inputs, params):  # type: ignore[arg-type]
            yield Block(block.array, np.maximum(block.data, 1), block.view) if block.array == "frames/mask" else block

    monkeypatch.setattr(frames, "run", brighter)
    events = dropped.run("orbit")
    monkeypatch.undo()
    assert any(isinstance(e, TaskNeeded) and e.task.stage == "depth" for e in events)
    assert "depth" in {e.task.stage for e in events if isinstance(e, TaskDone)}
    assert dropped.plan("orbit").all_fresh


def test_a_contact_sheet_has_the_few_pictures_it_shows_made_again_and_held(dropped: Pipeline, tmp_path: Path) -> None:
    held = needed(dropped.context(), False, True)
    plan = dropped.session.plan(NAME, Selection(), (), lambda c: held)
    # Three frames lie in three partitions; four of six source views and the held-out one are shown.
    assert plan.counts("frames")[State.STALE] == 3 * 5
    assert {r for v in plan.verdicts.values() for r in v.reasons} == {
        "its output was dropped and is needed by the export"
    }
    ended = Run([plan], Selection(), SerialBackend(), [Keeper([plan])]).go()
    assert ended.done == 15
    assert len(write_exports(plan, None, None, tmp_path / "sheet.png")) == 1


def test_reading_what_was_dropped_says_so(dropped: Pipeline) -> None:
    with pytest.raises(ShardMissing, match=r"was dropped to save space; set keep: {frames/color: always}"):
        Results(dropped.context()).read("frames/color", range(1), 0)


def test_a_keep_of_its_own_wins_over_the_run_s(finished: Pipeline, tmp_path: Path) -> None:
    one = finished.copy(tmp_path / "one").with_settings(
        "keep.depth/confidence=until_done", "keep.gaussians/confidence=never", "keep.pose/joints3d=never"
    )
    plan = one.plan()
    assert plan.all_fresh
    keeper = Keeper([plan])
    keeper.sweep()
    assert dropped_arrays(one.plan()) == {
        "depth/confidence",
        "gaussians/confidence",
        "pose/joints3d",
    }, "never takes even what nobody reads"
    assert keeper.bytes > 0
    kept = finished.copy(tmp_path / "two").with_settings(DROP, "keep.frames/color=always")
    Keeper([kept.plan()]).sweep()
    assert dropped_arrays(kept.plan()) == UNTIL_DONE - {"frames/color"}


def test_nothing_is_dropped_before_its_readers_are_done(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import posegaussian.stages.peers.run as rendering

    pipeline = Pipeline(tmp_path / "archive", finished.folder, [DROP, "keep.pose/joints3d=never"])
    pipeline.register()

    def failing(inputs: object, params: object) -> object:
        raise RuntimeError("out of paint")

    monkeypatch.setattr(rendering, "run", failing)
    pipeline.run(expect_failure=True)
    plan = pipeline.plan()
    assert dropped_arrays(plan) == {"pose/joints3d"}, "rendering failed, so what it reads stays; never waits for nobody"


def test_nothing_is_dropped_whose_sources_are_gone(finished: Pipeline, tmp_path: Path, person_folder: Path) -> None:
    import shutil

    folder = tmp_path / "capture"
    shutil.copytree(person_folder, folder)
    pipeline = Pipeline(tmp_path / "archive", folder, ["frames.range=0:2"])
    pipeline.register()
    pipeline.run()
    next((folder / "images").rglob("*.png")).unlink()
    keeper = Keeper([pipeline.with_settings(DROP).plan()])
    keeper.sweep()
    assert "nothing is dropped" in keeper.sentences[0]
    assert dropped_arrays(pipeline.plan()) == set()


def test_default_keeps_everything_and_unknown_arrays_are_refused() -> None:
    settings = load_configuration(folder=Path("/nonexistent")).default
    specs = {n: s for n, (_, s) in PRODUCERS.items() if hasattr(s, "keep")}
    assert {policy(settings, s) for s in specs.values()} == {"always"}  # type: ignore[arg-type]
    assert policy(settings, specs["frames/color"], declared=True) == "until_done"  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r'did you mean "frames/color"'):
        load_configuration(None, ["keep.frames/colour=never"])
    with pytest.raises(ConfigError, match=r"survey/plate.* is no array that can be dropped"):
        load_configuration(None, ["keep.survey/plate=never"])
