"""A stage that brings a fact, a dimension, a note, cameras or an asset: its declaration is all that planning asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from posegaussian.dags.assets.digest import asset_digest
from posegaussian.dags.planning import context, effects, plan
from posegaussian.dags.planning.fingerprint import PlannedAsset, assets
from posegaussian.stages.contract.declaration import Asset, Read, Stage
from posegaussian.stages.contract.facts import HELD_OUT, MASKS, fact
from posegaussian.stages.registry import ASSETS, STAGES, stage
from posegaussian.storage.model.spec import digest
from tests.support.pipeline import Pipeline, film

RAINY = fact("rainy_day")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("hooks")
    film(folder / "capture", size=32, frames=2, views=3)
    pipeline = Pipeline(folder / "archive", folder / "capture")
    pipeline.register()
    return pipeline


def with_last(monkeypatch: pytest.MonkeyPatch, **hooks: Any) -> Stage:
    """The registry with a last stage that declares more."""
    last = replace(STAGES[-1], **hooks)
    for module in (context, effects, plan):
        monkeypatch.setattr(module, "STAGES", (*STAGES[:-1], last))
    return last


def test_facts_are_told_in_the_order_of_flow(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def told(capture: Any, views: Any, params: Any, known: Any) -> list[str]:
        asked.append((len(capture.rig), views.held_out, type(params), known))
        return [RAINY]

    assert RAINY not in archive.context().facts
    with_last(monkeypatch, facts=told)
    made = archive.context()
    assert RAINY in made.capture_facts
    assert RAINY in made.facts
    ((cameras, held_out, params, known),) = asked
    assert (cameras, held_out, params) == (4, made.views.held_out, STAGES[-1].params)
    assert known >= {MASKS, HELD_OUT}, "what stages before it told, it knows"


def test_a_dimension_follows_from_the_settings_of_its_stage(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    with_last(monkeypatch, dimensions=lambda params, facts: {"drop": 7 if MASKS in facts else 1})
    assert archive.context().shape()["drop"] == 7


def test_a_note_is_shown_while_its_stage_is_needed(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    last = with_last(monkeypatch, notes=lambda evidence: [f"{len(evidence.sources)} views get wet"])
    assert "3 views get wet" in archive.plan().notes
    dry = replace(last, unneeded=lambda params, facts: "it is dry, so no stage is needed")
    for module in (context, effects):
        monkeypatch.setattr(module, "STAGES", (*STAGES[:-1], dry))
    assert "3 views get wet" not in archive.plan().notes


def test_cameras_are_those_of_the_pictures_unless_a_stage_declares_its_own(archive: Pipeline) -> None:
    made = archive.with_settings("frames.size=16").context()
    assert made.rig.size.max() == 16
    assert made.rig_of(stage("depth")) is made.rig
    own = replace(stage("depth"), cameras=lambda rig, params: rig)
    assert made.rig_of(own) is made.capture.rig


def test_an_asset_is_known_by_its_contents_and_by_the_code_that_runs_it(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    umbrella = Asset(
        "umbrella", lambda settings: digest(settings), lambda settings: settings, lambda params, facts: "red"
    )
    owner = STAGES[-1]
    monkeypatch.setitem(ASSETS, "umbrella", (owner, umbrella))
    reader = replace(stage("pose"), name="survey", reads=(Read.source("umbrella"),))
    assert assets(archive.context(), reader) == {"umbrella": PlannedAsset("red", digest("red"))}
    run_by = replace(umbrella, code=lambda settings: "posegaussian.stages.pose.run")
    assert asset_digest(run_by, "red") not in (
        digest("red"),
        asset_digest(replace(run_by, code=lambda s: "posegaussian.stages.depth.run"), "red"),
    )
