"""Incremental runs: what is fresh stays, what changed is named, only dependents rerun."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.planning import fingerprint
from posegaussian.dags.planning.explain import why as chain
from posegaussian.dags.planning.plan import State, judge
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.events import TaskDone, TaskFailed
from posegaussian.dags.runtime.ordering import lacks_description, scope_of
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.receipts import write_receipt
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, ended, film


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive that may be changed."""
    return finished.copy(tmp_path / "archive")


def stale(pipeline: Pipeline) -> dict[str, set[str]]:
    """{stage: reasons} of everything that is not fresh."""
    found: dict[str, set[str]] = {}
    for v in pipeline.plan().verdicts.values():
        if v.state is not State.FRESH:
            found.setdefault(v.task.stage, set()).update(v.reasons)
    return found


def test_after_a_run_everything_is_fresh_and_a_second_run_computes_nothing(archive: Pipeline) -> None:
    assert archive.plan().all_fresh
    assert archive.ran() == {}


def test_where_nothing_was_dropped_nobody_looks_for_what_was(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Task] = []
    real = Book.dropped_inputs
    monkeypatch.setattr(Book, "dropped_inputs", lambda book, task: [asked.append(task), real(book, task)][1])
    changed = archive.with_settings("gaussians.footprint=0.6")
    before = changed.plan()
    assert before.to_make
    assert asked == []
    task = next(t for t in before.book.receipts if t.stage == "depth")
    receipt = before.book.receipts[task]
    gone = tuple(replace(o, dropped=True) for o in receipt.outputs)
    write_receipt(changed.context().sequence, replace(receipt, outputs=gone))
    after = changed.plan()
    assert set(asked) >= {t for t in before.to_make if t.stage == "gaussians"}
    assert after.verdicts[task].state is not State.FRESH


def test_a_changed_setting_is_named_with_old_and_new_value_and_reruns_only_dependents(archive: Pipeline) -> None:
    changed = archive.with_settings("smoothing.omega=0.5")
    assert stale(changed) == {"smoothing": {"smoothing.omega 0.8 -> 0.5"}}
    assert changed.ran() == {"smoothing": 3}
    assert changed.plan().all_fresh


def test_another_frame_rate_is_told_to_the_stages_that_go_by_seconds_and_to_readers_of_times(
    archive: Pipeline, tmp_path: Path
) -> None:
    shutil.copytree(archive.folder, tmp_path / "slower")
    cameras = tmp_path / "slower" / "cameras.json"
    told = json.loads(cameras.read_text())
    was, told["frame_rate"] = told["frame_rate"], 5
    cameras.write_text(json.dumps(told))
    slower = Pipeline(archive.root, tmp_path / "slower", archive.settings, archive.partition, archive.held_out)
    slower.register()
    assert stale(slower)["pose"] == {f"the frame rate {was:g} -> 5"}
    pose = next(t for t in slower.plan().verdicts if t.stage == "pose")
    assert scope_of(slower.context(), pose).rate == 5
    assert lacks_description(slower.plan())
    assert slower.ran() == {"pose": 3}
    assert slower.plan().all_fresh
    assert not lacks_description(slower.plan())
    times = Archive.open(str(archive.root)).sequence(NAME).get("frames/time")
    np.testing.assert_array_equal(times, slower.context().source_frames / 5)


def test_a_result_that_lacks_an_output_is_made_anew(archive: Pipeline) -> None:
    """What is written hangs on facts that no fingerprint holds: Gaussians have a twist where cameras are rolled and a
    network may run, and what reads it would never find it in a result of before."""
    plan = archive.plan()
    for task in [t for t in plan.verdicts if not stage_named(t.stage).sequence_wide]:
        digests, receipt = plan.book.digests(task), plan.book.receipts[task]
        assert digests is not None
        lost = receipt.outputs[-1].array
        plan.book.receipts[task] = replace(receipt, outputs=tuple(o for o in receipt.outputs if o.array != lost))
        assert judge(plan.book, task, Selection(), digests)[:2] == (State.STALE, (f"{lost} is asked for",))
        plan.book.receipts[task] = receipt
        assert judge(plan.book, task, Selection(), digests)[0] is State.FRESH


def test_dependents_of_a_stale_stage_are_undecided_until_it_ran(archive: Pipeline) -> None:
    changed = archive.with_settings("gaussians.footprint=0.6")
    plan = changed.plan()
    assert plan.counts("gaussians") == {State.STALE: 3}
    assert plan.counts("rendering") == {State.UNDECIDED: 3}
    assert plan.counts("depth") == {State.FRESH: 3}
    assert set(changed.ran()) == {"gaussians", "rendering", "metrics"}


def test_equal_content_upstream_stops_the_rerun(archive: Pipeline) -> None:
    counts = archive.ran(selection=Selection(force=frozenset({"depth"})))
    assert counts == {"depth": 3}, "depth came out equal, so nothing behind it had to run"


def test_from_reruns_every_later_stage(archive: Pipeline) -> None:
    counts = archive.ran(selection=Selection(start="gaussians"))
    assert counts == {"gaussians": 3, "rendering": 3, "metrics": 3}


def test_only_leaves_other_stages_alone_and_says_so(archive: Pipeline) -> None:
    changed = archive.with_settings("depth.method=hull")
    events = changed.run(selection=Selection(only=frozenset({"smoothing", "gaussians"})), expect_failure=True)
    end = ended(events)
    assert end.done == 0
    assert end.blocked > 0


@pytest.mark.parametrize("name", ["depht", ""])
def test_an_unknown_stage_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(ConfigError, match=r"no stage .*survey, judge, detection, tracks, people, pose, frames"):
        Selection(only=frozenset({name}))


def test_a_deleted_shard_is_stale_and_made_anew(archive: Pipeline) -> None:
    shard = next(p for p in (archive.root / NAME / "depth/depth").glob("c.*"))
    shard.unlink()
    reasons = stale(archive)
    assert any("is missing or of another size" in r for r in reasons["depth"])
    assert archive.ran()["depth"] == 1
    assert shard.is_file()


def test_a_truncated_receipt_counts_as_none(archive: Pipeline) -> None:
    receipt = archive.root / NAME / "_receipts/depth/p000001.json"
    receipt.write_bytes(receipt.read_bytes()[:100])
    assert "never made" in stale(archive)["depth"]


def test_editing_a_kernel_makes_its_stage_stale_and_names_the_code(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = fingerprint.code_digest
    monkeypatch.setattr(
        fingerprint, "code_digest", lambda run: "f" * 32 if run.startswith("posegaussian.stages.depth.") else real(run)
    )
    reasons = stale(archive)
    assert any(r.startswith("code of depth changed") for r in reasons["depth"])
    assert "pose" not in reasons


def test_why_walks_back_to_the_first_cause(archive: Pipeline) -> None:
    changed = archive.with_settings("depth.pairs=1")
    plan = changed.plan()
    rendering = next(t for t in plan.verdicts if t.stage == "rendering")
    text = "\n".join(chain(plan, rendering))
    assert "depth p0000: stale (depth.pairs 2 -> 1)" in text
    assert text.index("rendering") < text.index("gaussians") < text.index("depth p0000")


def test_a_failed_partition_fails_alone(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    import posegaussian.stages.depth.run as depth

    real = depth.run

    def failing(inputs: object, params: object) -> object:
        if inputs.partition.start == 2:  # type: ignore[attr-defined]
            raise RuntimeError("the cosmic ray of partition 1")
        return real(inputs, params)  # type: ignore[arg-type]

    monkeypatch.setattr(depth, "run", failing)
    events = archive.run(selection=Selection(start="depth"), expect_failure=True)
    end = ended(events)
    failed = [e for e in events if type(e).__name__ == "TaskFailed"]
    assert [(e.task.stage, e.task.partition) for e in failed] == [("depth", 1)]
    assert "the cosmic ray" in failed[0].error
    blocked = {(e.task.stage, e.task.partition) for e in events if type(e).__name__ == "TaskBlocked"}
    assert ("gaussians", 1) in blocked
    assert ("rendering", 0) not in blocked
    assert end.failed == 1
    assert not (archive.root / NAME / "_receipts/depth/p000001.json").exists(), (
        "a failed rerun must not leave the old receipt"
    )
    monkeypatch.undo()
    archive.run()
    assert archive.plan().all_fresh


def test_plan_imports_no_numerical_library(archive: Pipeline) -> None:
    code = (
        "import sys; from posegaussian.dags.cli.app import app; from typer.testing import CliRunner; r ="
        f" CliRunner().invoke(app, ['plan', *{archive.options!r}]); print(r.exit_code, 'all fresh' in r.output, [m for"
        " m in ('torch', 'cv2', 'numba', 'av', 'distributed', 'OpenImageIO') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "0 True []", done.stdout + done.stderr


def test_a_task_is_labelled_by_camera() -> None:
    assert Task("s", "frames", 3, 1).label(("cam00", "cam01")) == "frames cam01 p0003"


def test_a_grown_range_says_which_frames_came_and_blames_no_source(archive: Pipeline) -> None:
    shorter = archive.with_settings("frames.range=0:5")
    reasons = stale(shorter)
    assert reasons["frames"] == {"frames of the partition 4..5 (2 frames) -> 4..4 (1 frames)"}


def test_a_shorter_range_says_of_no_file_that_it_changed_for_sure(archive: Pipeline) -> None:
    """Joints are followed into the frames around a partition, which are no longer there."""
    shorter = archive.with_settings("frames.range=0:4")
    views = shorter.context().views
    told = "source joints of {}, or which frames are read of it, changed"
    assert told.format(views.names[views.sources[0]]) in stale(shorter)["pose"]
    assert not any(r.startswith("source") for r in stale(shorter)["pose"] - {told.format(n) for n in views.names})


def test_inputs_that_are_no_longer_read_are_called_so(archive: Pipeline) -> None:
    fewer = archive.with_settings("views.sources=[cam00, cam01, cam02]", "depth.method=sgbm")
    assert any(r.endswith("of cam03 is no longer read") for r in stale(fewer)["depth"])
    assert not any("cam03 changed" in r for r in stale(fewer)["depth"])


def flip_a_bit(archive: Pipeline, array: str, partition: int, view: int) -> None:
    shard = next(p for p in (archive.root / NAME / array).glob(f"c.{partition}.{view}.*"))
    data = bytearray(shard.read_bytes())
    data[len(data) // 3] ^= 4
    shard.write_bytes(data)


def test_a_shard_with_a_flipped_bit_is_made_anew_and_its_reader_tried_again(archive: Pipeline) -> None:
    whole = content(archive)
    flip_a_bit(archive, "frames/color", 0, 3)
    events = archive.run(selection=Selection(force=frozenset({"depth"})))
    done = Counter((e.task.stage, e.task.partition, e.task.view) for e in events if isinstance(e, TaskDone))
    assert done[("frames", 0, 3)] == 1
    assert {stage for stage, _, _ in done} == {"frames", "depth"}, "equal content stops there"
    assert set(done.values()) == {1}
    assert_same_content(content(archive), whole)
    assert archive.plan().all_fresh


def test_a_damaged_shard_that_only_forbids_to_make_again_fails_its_reader_alone(archive: Pipeline) -> None:
    flip_a_bit(archive, "frames/color", 0, 3)
    depth = frozenset({"depth"})
    events = archive.run(selection=Selection(only=depth, force=depth), expect_failure=True)
    (failed,) = [e for e in events if isinstance(e, TaskFailed)]
    assert (failed.task.stage, failed.task.partition, failed.kind) == ("depth", 0, "damaged input")
    assert "posegaussian verify --sequence person --repair" in failed.error


def test_every_stage_works_on_pictures_that_reach_as_far_as_a_lens_filmed(tmp_path: Path) -> None:
    """And as the calibration is written where undistortion is off: no picture reaches beyond that one then."""
    person = film(tmp_path / "capture", views=3, frames=2, masks=False, depth=False)
    written = json.loads((tmp_path / "capture/cameras.json").read_text())
    for camera in written["cameras"]:
        camera["distortion"] = [-0.35, 0.12, 0, 0, 0]
    (tmp_path / "capture/cameras.json").write_text(json.dumps(written))
    bent = Pipeline(tmp_path / "archive", tmp_path / "capture", ["effects.undistortion=auto"])
    bent.register()
    context, off = bent.context("held_out"), bent.with_settings("effects.undistortion=off").context("held_out")
    own = [s for s in STAGES if s.cameras is not None]
    assert len(own) > 2
    for s in own:
        rig, plain = context.rig_of(s), off.rig_of(s)
        assert (rig.size > person.rig.size).all()
        assert (rig.intrinsics[:, 0, 0] == person.rig.intrinsics[:, 0, 0]).all()
        np.testing.assert_array_equal(plain.size, person.rig.size)
        np.testing.assert_array_equal(plain.intrinsics, person.rig.intrinsics)
    (path,) = context.paths.values()
    held_out = context.rig.index("mid00")
    np.testing.assert_array_equal(path.size, context.rig.size[[held_out]])
    assert (context.shape()["x"], context.shape()["y"]) == tuple(context.rig.size.max(axis=0))
