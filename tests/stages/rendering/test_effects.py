from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.rendering.effects import ANTI_ALIASING, HOLE_FILLING, OUTLINE_EVENING, SILHOUETTE_CLIPPING
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.cameras import CameraPath


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=192, frames=1, held_out=1)


def outlines(apart: np.ndarray) -> np.ndarray:
    """[8, 8, 4, 2] notes of eight cameras whose outlines lie [8, 8] apart, share of the longer side."""
    notes = np.zeros((8, 8, 4, 2))
    notes[..., 1, 0], notes[..., 1, 1] = np.triu(apart, 1), np.triu(np.ones((8, 8)), 1)
    return notes


def evidence(c: PersonCapture, targets: tuple[CameraPath, ...] = (), **noted: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(
        params=RenderingParams(),
        facts=frozenset({"masks"}),
        sources=c.views.sources,
        rig=c.rig,
        targets=targets,
        noted={k.replace("__", "/"): v for k, v in noted.items()},
    )


def test_masks_are_trusted_where_most_outlines_agree(person: PersonCapture) -> None:
    exact = np.zeros((8, 8))
    one_wrong = exact.copy()
    one_wrong[3], one_wrong[:, 3] = 0.02, 0.02
    for effect in (SILHOUETTE_CLIPPING, HOLE_FILLING, OUTLINE_EVENING):
        assert effect.decide(evidence(person), effect.threshold) is None  # type: ignore[arg-type]
        for apart, on, share in ((exact, True, 1.0), (one_wrong, True, 0.75), (exact + 0.02, False, 0.0)):
            found = effect.decide(evidence(person, survey__agreement=outlines(apart)), effect.threshold)  # type: ignore[arg-type]
            assert found is not None
            assert (found.on, found.measured) == (on, pytest.approx(share))
            assert "outlines" in found.reason
        unknown = effect.decide(evidence(person, survey__agreement=np.zeros((8, 8, 4, 2))), effect.threshold)  # type: ignore[arg-type]
        assert unknown is not None
        assert (unknown.on, unknown.measured) == (False, None)
        assert effect.lacks(unmasked())  # type: ignore[arg-type]


def test_outlines_that_are_redrawn_are_evened_whatever_the_given_ones_say(person: PersonCapture) -> None:
    redrawn = evidence(person)
    redrawn.facts |= {"outline_redrawing"}
    assert OUTLINE_EVENING.decide(redrawn, OUTLINE_EVENING.threshold) is None  # type: ignore[arg-type]
    redrawn.noted["survey/agreement"] = outlines(np.full((8, 8), 0.02))
    for effect in (SILHOUETTE_CLIPPING, HOLE_FILLING, OUTLINE_EVENING):
        found = effect.decide(redrawn, effect.threshold)  # type: ignore[arg-type]
        assert found is not None
        assert found.on == (effect is OUTLINE_EVENING)


def test_two_masks_clip_and_neither_fill_nor_even(person: PersonCapture) -> None:
    """Beyond what either shows is nobody; what both leave is not all somebody's."""
    two, one = evidence(person), evidence(person)
    two.sources, one.sources = (0, 1), (0,)
    assert SILHOUETTE_CLIPPING.lacks(two) is None  # type: ignore[arg-type]
    for effect in (HOLE_FILLING, OUTLINE_EVENING):
        assert "fewer than three" in str(effect.lacks(two))  # type: ignore[arg-type]
    for effect in (SILHOUETTE_CLIPPING, HOLE_FILLING, OUTLINE_EVENING):
        assert "single source view" in str(effect.lacks(one))  # type: ignore[arg-type]


def unmasked() -> SimpleNamespace:
    """Evidence of a capture without masks."""
    return SimpleNamespace(params=RenderingParams(), facts=frozenset(), sources=(0, 1, 2))


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


def test_estimated_masks_fill_holes_and_clip_stray_pieces() -> None:
    estimated = SimpleNamespace(params=RenderingParams(), facts=frozenset({"segmented"}), sources=(0, 1, 2), noted={})
    filling, clipping = (e.decide(estimated, e.threshold) for e in (HOLE_FILLING, SILHOUETTE_CLIPPING))  # type: ignore[arg-type]
    assert filling is not None
    assert clipping is not None
    assert (filling.on, clipping.on) == (True, True)
    for effect in (HOLE_FILLING, SILHOUETTE_CLIPPING):
        assert effect.lacks(estimated) is None  # type: ignore[arg-type]
        assert "nobody segments" in (effect.lacks(unmasked()) or "")  # type: ignore[arg-type]
