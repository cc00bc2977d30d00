"""Laws of the tasks of a sequence: what is read is made, once and before;
held-out pictures reach nobody but metrics."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from posegaussian.dags.config.settings import Settings
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.tasks import (
    PRODUCERS,
    Product,
    Task,
    dependencies,
    inputs,
    path_frames,
    producer,
    tasks,
)
from posegaussian.dags.runtime.ordering import scope_of
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.joint_sets import JOINT_SETS
from posegaussian.storage.model.spec import ArraySpec
from tests.support.sample_captures import make_capture

JOINT_SET = next(iter(JOINT_SETS))


def make(
    folder: Path,
    cameras: int = 4,
    count: int = 10,
    partition: int = 4,
    joints: bool = True,
    masks: bool = True,
    held_out: tuple[str, ...] = ("cam02",),
    paths: tuple[str, ...] = (),
    **settings: Any,
) -> Context:
    capture = make_capture(cameras, range(count), joints, masks)
    streams = tuple(replace(s, options={"joint_set": JOINT_SET}) if s is not None else None for s in capture.joints)
    sequence = Archive.open(str(folder), create=True).create_sequence(
        "kick", replace(capture, joints=streams), partition
    )
    # The network reads heatmaps; without it nobody does.
    own = {"views": {"held_out": list(held_out), "trust": "all"}, "network": {"weights": "fast"}}
    return make_context(sequence, Settings.model_validate(own | settings), paths)


VARIANTS: dict[str, dict[str, Any]] = {
    "everything": {},
    "no held-out view": {"held_out": ()},
    "no joints": {"joints": False},
    "no masks": {"masks": False},
    "no masks and no plate": {"masks": False, "frames": {"matte": "none"}},
    "one frame": {"frames": {"range": "3:4"}, "partition": 1},
    "one partition": {"partition": 64},
    "recurrent": {"smoothing": {"method": "recurrent", "truncation": 5}, "partition": 2},
    "hull": {"depth": {"method": "hull"}},
    "two paths": {"paths": ("held_out", "still cam01")},
    "some sources": {"views": {"sources": ["cam01", "cam04"], "held_out": ["cam03"]}},
}


@pytest.fixture(params=VARIANTS)
def context(request: pytest.FixtureRequest, tmp_path: Path) -> Context:
    return make(tmp_path, **VARIANTS[request.param])


def products(context: Context, task: Task) -> list[Product]:
    """What a task writes, from its stage's declaration."""
    found = []
    for spec in stage_named(task.stage).writes_for(context.facts):
        per_view = isinstance(spec, ArraySpec) and spec.per_view
        views = [None] if not per_view else [task.view] if task.view is not None else range(len(context.rig))
        found += [Product(spec.name.format(path=task.path), task.partition, v) for v in views]
    return found


def test_tasks_are_unique_and_their_dependencies_come_before(context: Context) -> None:
    done: set[Task] = set()
    for task in tasks(context):
        assert task not in done
        assert set(dependencies(context, task)) <= done, task
        done.add(task)


def test_every_product_is_written_by_one_task_and_everything_read_is_written(context: Context) -> None:
    made: dict[Product, Task] = {}
    for task in tasks(context):
        for p in products(context, task):
            assert p not in made, f"{p} is written by {made[p]} and {task}"
            made[p] = task
    for task in tasks(context):
        for i in inputs(context, task):
            assert i.products, f"{task} reads nothing of {i.name}"
            for p in i.products:
                assert made[p] == producer(p, task)


def test_partitions_of_a_stage_cover_every_frame_once(context: Context) -> None:
    for stage in {t.stage for t in tasks(context)}:
        if "time" in stage_named(stage).over:
            combinations = {(t.view, t.path) for t in tasks(context) if t.stage == stage}
            for view, path in combinations:
                frames = [
                    f
                    for t in tasks(context)
                    if (t.stage, t.view, t.path) == (stage, view, path)
                    for f in context.grid.bounds(t.partition or 0)
                ]
                assert frames == list(range(context.grid.frames))


def test_an_input_covers_the_partition_and_its_halo(context: Context) -> None:
    for task in tasks(context):
        for i in inputs(context, task):
            if not i.spec.per_frame or task.partition is None:
                assert len(i.span) == 0
                continue
            halo = i.read.halo_for(context.params(stage_named(task.stage)), context.facts)
            assert i.span == context.grid.span(task.partition, halo)
            touched = {p.partition for p in i.products}
            assert {f // context.grid.length for f in i.span} == touched


def test_a_task_sees_its_path_over_its_frames_and_over_what_it_reads_along_it_alone(tmp_path: Path) -> None:
    """Frames of joints that are read beside the partition are none of the path's."""
    context = make(tmp_path, effects={"pose_blending": "on"})
    drawn, measured = (Task("kick", s, 1, None, next(iter(context.paths))) for s in ("rendering", "metrics"))
    assert context.grid.bounds(1) == range(4, 8)
    assert {i.name: i.span for i in inputs(context, drawn)}["pose/joints2d"] == range(8)
    for task, seen in ((drawn, range(4, 8)), (measured, range(3, 8))):
        assert path_frames(context, task) == seen
        assert scope_of(context, task).path.served.shape[0] == 4  # type: ignore[union-attr]


def test_the_stages_that_the_guide_names_are_enough_to_hear_who_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And none of them is too many: which way cameras stand, detection must know."""
    monkeypatch.setattr("posegaussian.stages.detection.asset.blazepose_is_here", lambda: True)
    guide = Path("docs/guide/pose.md").read_text()
    (command,) = re.findall(r"`posegaussian run ((?:--only \w+ ?)+)`", guide)
    context = make(tmp_path, joints=False, views={"held_out": ["cam02"]})
    behind = {t for t in tasks(context) if t.stage == "tracks"}
    while more := {d for t in behind for d in dependencies(context, t)} - behind:
        behind |= more
    assert {t.stage for t in behind} == set(command.replace("--only", "").split())


def test_pictures_of_held_out_views_are_read_by_metrics_alone(context: Context) -> None:
    held_out = set(context.views.held_out)
    for task in tasks(context):
        for i in inputs(context, task):
            if i.name.startswith("frames/") and task.stage != "metrics" and i.spec.per_view:
                assert not held_out & set(i.views), f"{task} reads {i.name} of a held-out view"


def test_metrics_compare_with_the_held_out_pictures_and_ask_the_sources_what_is_hidden(tmp_path: Path) -> None:
    context = make(tmp_path, held_out=("cam02", "cam04"))
    first, *_ = [t for t in tasks(context) if t.stage == "metrics"]
    assert {i.name: i.views for i in inputs(context, first) if i.spec.per_view} == {
        "frames/color": (1, 3),
        "frames/mask": (0, 2, 1, 3),
    }


def test_nothing_reads_frames_of_a_view_without_a_role(tmp_path: Path) -> None:
    context = make(tmp_path, cameras=5, **VARIANTS["some sources"])
    assert context.active_views == (0, 2, 3)
    assert {t.view for t in tasks(context) if t.stage == "frames"} == {0, 2, 3}


def test_what_a_capture_lacks_has_no_tasks(tmp_path: Path) -> None:
    def stages(name: str, **kw: Any) -> set[str]:
        return {t.stage for t in tasks(make(tmp_path / name, **kw))}

    # joints came with it, or nobody estimates them
    everything = {s.name for s in STAGES} - {"detection", "tracks", "people"}
    assert stages("a") == everything
    assert stages("b", masks=False) == everything, "joints and the background say who is judged"
    assert stages("c", joints=False) == everything - {"pose", "smoothing"}, "masks are surveyed"
    assert stages("d", held_out=()) == everything - {"metrics"}
    assert stages("h", cameras=3) == everything - {"refinement"}, "two sources, and none of them can judge"
    unasked = dict.fromkeys(
        (
            "calibration_correction",
            "noise_averaging",
            "exposure_matching",
            "outline_correction",
            "gap_opening",
            "outline_redrawing",
            "limb_bounds",
            "silhouette_clipping",
            "hole_filling",
            "outline_evening",
            "pose_blending",
            "source_detail",
        ),
        "off",
    )
    assert stages("e", effects={**unasked, "temporal_smoothing": "on"}) == everything - {"survey"}
    assert stages("f", effects={**unasked, "temporal_smoothing": "off"}) == everything - {"survey", "smoothing"}
    assert stages("g", effects={**unasked, "limb_bounds": "on", "pose_heatmaps": "off"}) == everything - {
        "survey",
        "smoothing",
    }


def test_the_halo_of_a_filter_makes_its_tasks_wait_for_the_partitions_before(tmp_path: Path) -> None:
    def before(name: str, **kw: Any) -> list[int | None]:
        context = make(tmp_path / name, partition=2, **kw)
        return [t.partition for t in dependencies(context, Task("kick", "smoothing", 3)) if t.stage == "pose"]

    assert before("a") == [2, 3]
    assert before("b", smoothing={"method": "recurrent", "truncation": 5}) == [0, 1, 2, 3]


def test_metrics_run_only_over_paths_with_truth(tmp_path: Path) -> None:
    context = make(tmp_path, paths=("held_out", "orbit"))
    kinds = {
        stage: {context.paths[t.path].kind for t in tasks(context) if t.stage == stage and t.path}
        for stage in ("rendering", "metrics")
    }
    assert kinds == {"rendering": {"held_out", "orbit"}, "metrics": {"held_out"}}


def test_every_declared_output_has_one_producer() -> None:
    assert len(PRODUCERS) == sum(len(s.writes) for s in STAGES)


@pytest.mark.parametrize(("partition", "view", "path"), list(product([None, 3], [None, 1], [None, "orbit-1"])))
def test_a_label_holds_what_tells_a_task_from_others(partition: int | None, view: int | None, path: str | None) -> None:
    label = Task("kick", "depth", partition, view, path).label(("a", "cam02"))
    assert label.split() == [p for p in ("depth", path, view and "cam02", partition and "p0003") if p]
