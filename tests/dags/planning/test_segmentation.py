"""BlazePose beside given joints: it segments the person where a matte wants that, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.dags.planning.fingerprint import assets
from posegaussian.stages.frames.stage import STAGE as FRAMES
from posegaussian.stages.network.params import NETWORK
from posegaussian.stages.registry import stage
from tests.support.pipeline import Pipeline, film


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Pipeline]:
    """A capture with joints and without masks, and one with both."""
    out = {}
    for name, masks in (("joints", False), ("masks", True)):
        folder = tmp_path_factory.mktemp(name)
        film(folder / "capture", size=32, frames=2, masks=masks)
        out[name] = Pipeline(folder / "archive", folder / "capture")
        out[name].register()
    return out


def matte(pipeline: Pipeline) -> str:
    (choice,) = FRAMES.choices
    context = pipeline.context()
    return choice.resolve(context.params(FRAMES), context.facts)[0]


def test_with_given_joints_blazepose_segments_where_it_is_here(
    captures: dict[str, Pipeline], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.detection.asset.blazepose_is_here", lambda: True)
    plan = captures["joints"].plan()
    assert plan.context.joint_set == "coco17", "the joints are the given ones"
    assert matte(captures["joints"]) == "person"
    assert plan.counts("detection").total() > 0
    read = {r.array for r in FRAMES.reads_for(plan.context.params(FRAMES), plan.context.facts)}
    assert {"detection/person", "detection/region", "pose/chosen"} <= read
    # The estimator's heatmaps belong to joints that nobody reads.
    assert "detection/heatmaps" not in {w.name for w in stage("detection").writes_for(plan.context.facts)}
    assert "detected" not in plan.context.facts
    assert not [n for n in plan.notes if "frames.matte" in n]


@pytest.mark.parametrize(
    ("capture", "setting"),
    [
        ("masks", ()),
        ("joints", ("frames.matte=plate",)),
        ("joints", ("frames.matte=none",)),
        ("joints", ("detection.estimator=none",)),
    ],
)
def test_the_estimator_does_not_run_where_nothing_reads_it(
    captures: dict[str, Pipeline], monkeypatch: pytest.MonkeyPatch, capture: str, setting: tuple[str, ...]
) -> None:
    monkeypatch.setattr("posegaussian.stages.detection.asset.blazepose_is_here", lambda: True)
    plan = captures[capture].with_settings(*setting).plan()
    assert "detection" in plan.unneeded
    assert not plan.counts("detection")


def test_without_blazepose_the_given_joints_tell_alone_and_the_plan_says_what_would_be_better(
    captures: dict[str, Pipeline], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.detection.asset.blazepose_is_here", lambda: False)
    plan = captures["joints"].plan()
    assert matte(captures["joints"]) == "person"
    assert "detection" in plan.unneeded
    (said,) = [n for n in plan.notes if "frames.matte" in n]
    assert "posegaussian models fetch blazepose" in said
    assert not [n for n in captures["masks"].plan().notes if "frames.matte" in n]


def test_every_task_that_opens_models_is_told_which_the_plan_means(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The survey's fingerprint names no sources, yet it looks at pictures through the estimator, too."""
    monkeypatch.setattr("posegaussian.stages.detection.asset.blazepose_is_here", lambda: True)
    film(tmp_path / "capture", size=32, frames=2, masks=False, joints=False)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture").with_settings("network.weights=fast")
    pipeline.register()
    plan = pipeline.plan()
    for task in plan.verdicts:
        declared = stage(task.stage)
        asked = {r.array for r in declared.reads_for(plan.context.params(declared), plan.context.facts) if r.is_source}
        assert set(assets(plan.context, declared)) == asked & {"estimator", NETWORK}, task.stage
    assert "estimator" in assets(plan.context, stage("survey"))
