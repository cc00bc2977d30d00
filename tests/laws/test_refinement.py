"""The laws of a stage that its settings leave out: without steps it is as good as absent, with them rendering reads
what it made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.results import Results
from posegaussian.stages.rendering.sources import COUNTS, REFINED
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, receipts

SHORT = ["frames.range=0:3", "gaussians.opacity=0.1"]
"""Gaussians so transparent that two steps make their pictures better."""


def run(folder: Path, root: Path, *settings: str, partition: int = 2) -> Pipeline:
    p = Pipeline(root, folder, [*SHORT, *settings], partition)
    p.register()
    p.run()
    return p


@pytest.fixture(scope="module")
def plain(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    return run(person_folder, tmp_path_factory.mktemp("plain") / "archive", "refinement.steps=0")


@pytest.fixture(scope="module")
def refined(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    return run(
        person_folder, tmp_path_factory.mktemp("refined") / "archive", "refinement.steps=2", "refinement.group=2"
    )


def test_without_steps_nothing_of_it_is_planned_read_or_written(plain: Pipeline) -> None:
    plan = plain.plan()
    assert "refinement.steps is 0" in plan.unneeded["refinement"]
    assert not any(t.stage == "refinement" for t in plan.verdicts)
    assert "refinement" not in plan.context.facts
    assert not (plain.root / NAME / "refinement").exists()
    assert not any(key[0] == "refinement" for key in receipts(plain))


def test_rendering_reads_the_refined_maps_and_only_what_follows_is_made_again(
    plain: Pipeline, refined: Pipeline
) -> None:
    before, after = content(plain), content(refined)
    assert {k: v for k, v in after.items() if not k.startswith(("refinement", "rendering", "metrics"))} == {
        k: v for k, v in before.items() if not k.startswith(("rendering", "metrics"))
    }
    results = Results(refined.context())
    assert (results.read("refinement/outcome", range(3))[:, 4] > 0).all(), "of every frame a step was kept"
    counts, pixels = results.read(COUNTS, range(3), 1), np.prod(results.read("frames/mask", range(1), 1)[0].shape)
    assert (counts > 0).all()
    assert (counts < pixels / 4).all(), "few of them are left"
    for name in REFINED:
        whole, first = (results.read(name, range(3), 1, n) for n in (None, int(counts.max())))
        assert whole.shape[:2] == (3, pixels)
        np.testing.assert_array_equal(whole[:, : counts.max()], first)
        assert not any(own[n:].any() for own, n in zip(whole, counts, strict=True))
    assert (results.read("refinement/twist", range(3), 1)[..., 1] != 0).any()
    assert any(before[k] != after[k] for k in before if k.startswith("rendering"))


def test_turning_it_on_and_off_again_reruns_nothing_before_it(
    plain: Pipeline, refined: Pipeline, tmp_path: Path
) -> None:
    copy = plain.copy(tmp_path / "copy")
    on = copy.with_settings("refinement.steps=2", "refinement.group=2")
    assert set(on.ran()) == {"refinement", "rendering", "metrics"}
    assert_same_content(content(on), content(refined))
    assert set(copy.ran()) == {"rendering", "metrics"}
    assert_same_content(content(copy, but=("refinement",)), content(plain))
    assert all(v.state is State.FRESH for v in copy.plan().verdicts.values())


@pytest.mark.parametrize("length", [1, 3])
def test_any_partition_length_gives_the_same_bytes(
    person_folder: Path, refined: Pipeline, tmp_path: Path, length: int
) -> None:
    other = run(person_folder, tmp_path / "archive", "refinement.steps=2", "refinement.group=2", partition=length)
    assert_same_content(content(other), content(refined))
