"""No stage runs without a reader, for any setting; what is named is made all the same."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import PRODUCERS, inputs, tasks
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.spec import ArraySpec
from tests.support.pipeline import Pipeline, film

SETTINGS = [
    list(each)
    for each in itertools.product(
        ["network.weights=none", "network.weights=fast"],
        ["effects.temporal_smoothing=on", "effects.temporal_smoothing=off"],
        ["effects.pose_heatmaps=on", "effects.pose_heatmaps=off", "effects.pose_heatmaps=auto"],
        ["refinement.steps=0", "refinement.steps=20"],
    )
]
NONE_KEPT = "keep={pose/heatmaps: until_done, smoothing/heatmaps: until_done}"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("demand")
    film(folder / "capture", views=4, frames=2)
    p = Pipeline(folder / "archive", folder / "capture", [NONE_KEPT])
    p.register()
    return p


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda s: " ".join(x.split(".")[1] for x in s))
def test_no_stage_runs_without_a_reader(filmed: Pipeline, settings: list[str]) -> None:
    context = filmed.with_settings(*settings).plan().context
    planned = list(tasks(context))
    read = {i.read.array for t in planned for i in inputs(context, t)}
    for stage in {t.stage: next(s for s in STAGES if s.name == t.stage) for t in planned}.values():
        made = stage.writes_for(context.facts)
        results = [w.name for w in made if not isinstance(w, ArraySpec) or w.keep != "until_done"]
        assert stage.sequence_wide or results or read & {w.name for w in made}, f"{stage.name}: nobody reads {made}"
        drawn = {w.name for w in made if w.when in context.effects}
        assert drawn <= read, f"{stage.name} draws {drawn - read} for nobody"
    assert read <= PRODUCERS.keys()


def test_without_the_network_no_heatmap_is_made_and_the_plan_says_why(filmed: Pipeline) -> None:
    plan = filmed.with_settings("network.weights=none").plan()
    assert plan.unneeded["smoothing"] == "the effect pose_heatmaps is off"
    effects = plan.context.effects
    assert [effects[n].state for n in ("pose_heatmaps", "temporal_smoothing")] == ["off", "off"]
    decision = effects["pose_heatmaps"].decision
    assert decision is not None
    assert decision.reason == "no stage reads pose/heatmaps under these settings"
    learned = filmed.with_settings("network.weights=fast").plan()
    assert "smoothing" not in learned.unneeded
    assert learned.context.effects["pose_heatmaps"].state == "on"


def test_what_a_command_or_the_settings_name_is_made_all_the_same(filmed: Pipeline) -> None:
    without = filmed.with_settings("network.weights=none")
    for selection in (Selection(only=frozenset({"pose", "smoothing"})), Selection(force=frozenset({"smoothing"}))):
        assert not {"pose", "smoothing"} & without.plan(selection=selection).unneeded.keys()
    kept = without.with_settings("keep.smoothing/heatmaps=always").plan()
    assert "smoothing" not in kept.unneeded
    assert kept.context.effects["pose_heatmaps"].state == "on", "smoothing reads them"


def test_what_an_open_choice_may_read_waits_for_it(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=8, frames=2)
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", [NONE_KEPT, "network.weights=auto"])
    p.register()
    context = p.context()
    assert context.effects["pose_heatmaps"].state == "undecided"
    assert "judge/network" in context.waits["pose"]
    assert "judge/network" in context.facts
