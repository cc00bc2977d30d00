from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.rendering.effects import ANTI_ALIASING, HOLE_FILLING, SILHOUETTE_CLIPPING
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.algorithms.silhouettes import agreeing_share
from posegaussian.storage.model.cameras import CameraPath


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=192, frames=1, held_out=1)


def shares(c: PersonCapture, masks: dict[int, np.ndarray]) -> np.ndarray:
    return np.array([[agreeing_share(c.rig, masks, v)] for v in masks])


def evidence(c: PersonCapture, targets: tuple[CameraPath, ...] = (), **noted: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(
        facts=frozenset({"masks"}),
        sources=c.views.sources,
        rig=c.rig,
        targets=targets,
        noted={k.replace("__", "/"): v for k, v in noted.items()},
    )


def test_masks_are_trusted_where_their_rims_agree(person: PersonCapture) -> None:
    masks = {v: person.mask[0, v] for v in range(8)}
    for effect in (SILHOUETTE_CLIPPING, HOLE_FILLING):
        assert effect.decide(evidence(person), effect.threshold) is None  # type: ignore[arg-type]
        good = effect.decide(evidence(person, survey__silhouettes=shares(person, masks)), effect.threshold)  # type: ignore[arg-type]
        assert good is not None
        assert good.on
        shifted = masks | {3: np.roll(masks[3], 6, axis=1)}
        bad = effect.decide(evidence(person, survey__silhouettes=shares(person, shifted)), effect.threshold)  # type: ignore[arg-type]
        assert bad is not None
        assert not bad.on
        assert "rims" in bad.reason
        unknown = effect.decide(evidence(person, survey__silhouettes=np.full((8, 1), -1.0)), effect.threshold)  # type: ignore[arg-type]
        assert unknown is not None
        assert unknown.measured is None
        assert effect.lacks(SimpleNamespace(facts=frozenset(), sources=(0, 1, 2)))  # type: ignore[arg-type]


def test_anti_aliasing_is_for_targets_coarser_than_the_sources(person: PersonCapture) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(1))
    found = ANTI_ALIASING.decide(evidence(person, targets=(path,)), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert found is not None
    assert not found.on
    coarse = replace(path, intrinsics=path.intrinsics * np.array([0.5, 0.5, 1.0])[:, None])
    found = ANTI_ALIASING.decide(evidence(person, targets=(path, coarse)), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert found is not None
    assert found.on
    assert found.measured == pytest.approx(2.0, rel=0.1)
    unserved = replace(coarse, served=np.zeros_like(coarse.served))
    found = ANTI_ALIASING.decide(evidence(person, targets=(path, unserved)), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert found is not None
    assert not found.on
    nothing = ANTI_ALIASING.decide(evidence(person, targets=()), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert nothing is not None
    assert nothing.measured is None


def test_estimated_masks_fill_holes_and_clip_nothing_unless_asked() -> None:
    estimated = SimpleNamespace(facts=frozenset({"segmented"}), sources=(0, 1, 2), noted={})
    filling, clipping = (e.decide(estimated, e.threshold) for e in (HOLE_FILLING, SILHOUETTE_CLIPPING))  # type: ignore[arg-type]
    assert filling is not None
    assert clipping is not None
    assert (filling.on, clipping.on) == (True, False)
    for effect in (HOLE_FILLING, SILHOUETTE_CLIPPING):
        assert effect.lacks(estimated) is None  # type: ignore[arg-type]
        assert "nobody segments" in (effect.lacks(SimpleNamespace(facts=frozenset(), sources=(0, 1, 2))) or "")  # type: ignore[arg-type]
