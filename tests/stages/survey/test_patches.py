"""Patches of the body that several cameras see."""

import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.imaging.color import to_linear
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.algorithms.patches import (
    DIRECTIONS,
    JOINTS,
    NAMES,
    PATCHES,
    patch_points,
    typical_colors,
)
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.stage import STAGE
from tests.support.frame_readers import Joints, Pictures
from tests.support.memory_inputs import run_stage


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(6, 192, 3, 0, "wave")


def test_patches_lie_around_the_limbs_outwards(person: PersonCapture) -> None:
    points, directions, radii = patch_points(person.joints3d[0], person.rig)
    assert points.shape == directions.shape == (PATCHES, 3)
    shown = radii > 0
    assert 0.4 * PATCHES < shown.sum() < 0.8 * PATCHES
    joints = np.repeat(person.joints3d[0, JOINTS, :3], DIRECTIONS, axis=0)
    np.testing.assert_allclose(np.linalg.norm(points - joints, axis=1)[shown], radii[shown], atol=1e-12)
    assert np.abs(directions[:, 2]).max() < 0.2, (
        "nearly horizontal: the cameras' mean upward axis is the person's but for their tilt"
    )
    left = np.array([NAMES[j] == "LHip" for j in np.repeat(JOINTS, DIRECTIONS)])
    right = np.array([NAMES[j] == "RHip" for j in np.repeat(JOINTS, DIRECTIONS)])
    assert directions[left & shown].mean(axis=0) @ directions[right & shown].mean(axis=0) < 0
    unknown = person.joints3d[0] * [1, 1, 1, 0]
    assert not patch_points(unknown, person.rig)[2].any()


def test_clipped_dark_and_rarely_seen_patches_are_unknown() -> None:
    samples = np.full((4, PATCHES, 3), 100.0)
    samples[:, 0, 1] = 255
    samples[:, 1] = 3
    samples[1:, 2] = 0
    found = typical_colors(samples)
    assert (found[:3] == 0).all()
    np.testing.assert_allclose(found[3:], to_linear(np.array(100.0)), rtol=1e-6)


class Unreadable(Pictures):
    def read(self, view: int, numbers: object) -> object:  # type: ignore[override]
        raise AssertionError("a picture was decoded")


@pytest.mark.parametrize("asked", [frozenset({"survey/motion"}), frozenset()])
def test_pictures_are_not_decoded_for_what_joints_tell(asked: frozenset[str]) -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    pictures = Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2)
    sources = {"pictures": pictures, "joints": Joints(person.joints2d[:, 0])}
    out = run_stage(
        STAGE,
        SurveyParams(),
        {},
        person.rig,
        Views(person.rig.names, (0, 1), ()),
        8,
        view=0,
        sources=sources,
        facts=frozenset({"joints2d"}) | asked,
    )
    assert set(out) == {"survey/sample"} | asked
    if asked:
        assert out["survey/motion"][0, 2] > 0


def test_nothing_follows_from_a_view_that_is_no_source() -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    sources = {
        "pictures": Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2),
        "joints": Joints(person.joints2d[:, 0]),
    }
    out = run_stage(
        STAGE,
        SurveyParams(),
        {},
        person.rig,
        Views(person.rig.names, (1,), (0,)),
        8,
        view=0,
        sources=sources,
        facts=frozenset({"joints2d", "survey/motion", "survey/colors"}),
    )
    assert not out["survey/motion"].any()
    assert not out["survey/colors"].any()
