"""A refined frame's picture: as without refinement, of the refined Gaussians alone, or between the two."""

import cv2
import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract import reading
from posegaussian.stages.contract.facts import MASKS, Facts
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering import clipping
from posegaussian.stages.rendering.facts import SILHOUETTE_CLIPPING
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.sources import OUTCOME, REFINED, REFINEMENT, unrefined_arrays
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.support.memory_inputs import run_stage
from tests.support.refined_lists import as_lists, as_maps

COLOR, ALPHA = "rendering/{path}/color", "rendering/{path}/alpha"
SHARES = (0.0, 1.0, 0.25)


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=6, size=48, frames=len(SHARES), held_out=1)


@pytest.fixture(scope="module")
def arrays(person: PersonCapture) -> dict[str, np.ndarray]:
    """Every frame is the first; refined it is half as bright and half as opaque."""
    given = {
        name: np.repeat(a[:1], len(SHARES), axis=0)
        for name, a in {
            "depth/depth": person.depth,
            "depth/confidence": (person.depth > 0).astype(np.float16),
            "frames/color": person.color,
            "frames/mask": person.mask,
        }.items()
    }
    given |= run_stage(stage("gaussians"), GaussiansParams(), given, person.rig, person.views, len(SHARES))
    maps = {a: given[b].copy() for a, b in zip(REFINED[:-3], unrefined_arrays(Facts(frozenset())), strict=True)}
    maps["refinement/twist"], maps["refinement/shift"] = (np.zeros_like(given["gaussians/opacity"]) for _ in range(2))
    maps["refinement/twist"][:, :, 0] = 1
    maps["refinement/color"] //= 2
    maps["refinement/opacity"] /= 2
    given |= as_lists(maps)
    given[OUTCOME] = np.zeros((len(SHARES), 8), np.float32)
    given[OUTCOME][:, -1] = SHARES
    return given


def render(person: PersonCapture, arrays: dict[str, np.ndarray], *facts: str) -> dict[str, np.ndarray]:
    """Without retouches, which are not linear."""
    path = make_path("held_out", person.rig, person.views, np.arange(len(SHARES)))
    made = run_stage(
        stage("rendering"),
        RenderingParams(),
        arrays,
        person.rig,
        person.views,
        len(SHARES),
        path=path,
        facts=Facts(frozenset(facts)),
        effects=frozenset(),
    )
    return {name: made[name].astype(float) for name in (COLOR, ALPHA)}


def test_how_many_frames_are_read_at_once_changes_nothing(
    person: PersonCapture, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of frames that differ, before and after refinement."""
    names = ("frames/color", "refinement/color")
    different = {**arrays, **{name: arrays[name].copy() for name in names}, OUTCOME: arrays[OUTCOME].copy()}
    for frame, part in ((1, 3), (2, 2)):
        for name in names:
            different[name][frame] //= part
    different[OUTCOME][:, -1] = 0.5
    whole = render(person, different, REFINEMENT)
    monkeypatch.setattr(reading, "AT_ONCE", 1)
    for name, array in render(person, different, REFINEMENT).items():
        np.testing.assert_array_equal(array, whole[name])


def test_the_share_goes_from_one_picture_to_the_other(person: PersonCapture, arrays: dict[str, np.ndarray]) -> None:
    plain, out = render(person, arrays), render(person, arrays, REFINEMENT)
    for name in (COLOR, ALPHA):
        none, whole, part = out[name]
        np.testing.assert_array_equal(none, plain[name][0])
        assert np.abs(whole - none).max() > 20, "the two differ"
        np.testing.assert_allclose(part, 0.25 * whole + 0.75 * none, atol=1)  # three roundings to whole numbers


@pytest.mark.parametrize("width", [0.0, 3.0])
def test_soft_mattes_take_nothing_within_them_off_refined_pictures(
    person: PersonCapture, arrays: dict[str, np.ndarray], width: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As clipped by what the least of them leaves: exact masks, and pictures without refinement, stay."""
    soft = arrays["frames/mask"].copy()
    if width:
        for matte in soft.reshape(-1, *soft.shape[2:]):
            cv2.GaussianBlur(matte, (0, 0), width / 2.563, dst=matte)
    opaque = as_maps(arrays, person.rig) | {"refinement/opacity": arrays["gaussians/opacity"]}
    given = {**arrays, "frames/mask": soft, **as_lists(opaque)}
    facts = (REFINEMENT, MASKS, SILHOUETTE_CLIPPING)
    spared = render(person, given, *facts)[ALPHA]
    monkeypatch.setattr(clipping, "SPARED", 0.0)
    clipped = render(person, given, *facts)[ALPHA]
    assert (spared >= clipped).all()
    np.testing.assert_array_equal(spared[0], clipped[0])
    assert [(spared[i] > clipped[i]).any() for i in (1, 2)] == [width > 0] * 2
    # nothing is left far beside the person
    held_out = cv2.dilate(person.mask[0, person.views.held_out[0]], np.ones((9, 9), np.uint8))
    assert not spared[1, 0][held_out == 0].any()
