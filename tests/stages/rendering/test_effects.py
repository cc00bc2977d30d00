from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stages.capture.person import PersonCapture, capture_person
from stages.rendering.effects import ANTI_ALIASING, HOLE_FILLING, SILHOUETTE_CLIPPING
from stages.survey.silhouettes import agreeing_share


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=192, frames=1, held_out=1)


def shares(c: PersonCapture, masks: dict[int, np.ndarray]) -> np.ndarray:
    return np.array([[agreeing_share(c.rig, masks, v)] for v in masks])


def evidence(c: PersonCapture, **noted: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(facts=frozenset({"masks"}), sources=c.views.sources, rig=c.rig, noted={k.replace("__", "/"): v for k, v in noted.items()})


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


def test_anti_aliasing_is_for_cameras_coarser_than_the_sources(person: PersonCapture) -> None:
    found = ANTI_ALIASING.decide(evidence(person), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert found is not None
    assert not found.on
    coarse = person.rig.intrinsics.copy()
    coarse[8, :2] *= 0.5
    found = ANTI_ALIASING.decide(evidence(replace(person, rig=replace(person.rig, intrinsics=coarse))), ANTI_ALIASING.threshold)  # type: ignore[arg-type]
    assert found is not None
    assert found.on
    assert found.measured == pytest.approx(2.0, rel=0.1)
