"""Comparing cameras by patches of the body, against gains that were put on."""

import cv2
import numpy as np
import pytest

from stages.capture.person import PersonCapture, capture_person
from stages.frames.display import gain_table, to_display, to_linear
from stages.io import Views
from stages.survey.exposure import DIRECTIONS, JOINTS, NAMES, PATCHES, match, patch_colors, patch_points, typical_colors
from stages.survey.params import COLORS, MOTION, SurveyParams
from stages.survey.stage import STAGE
from tests.memory import run_stage
from tests.stages.frames.fakes import Joints, Pictures


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(6, 192, 3, 0, "wave")


def colors(person: PersonCapture, gain: dict[int, tuple[float, float, float]] | None = None) -> np.ndarray:
    """[6, 192, 3] patches of all cameras, some of them with gains on their light."""
    crops, out = np.tile([1.0, 0, 0], (6, 1)), []
    for v in range(6):
        table = gain_table(np.array((gain or {}).get(v, (1.0, 1.0, 1.0))))
        shown = [patch_colors(cv2.LUT(person.color[f, v], table), person.joints3d[f], person.rig, person.rig, crops, v) for f in range(3)]
        out.append(typical_colors(np.stack(shown)))
    return np.stack(out)


def test_equal_cameras_are_found_equal(person: PersonCapture) -> None:
    found = match(colors(person))
    assert found is not None
    assert found.proven.max() < 0.12, "stops"


def test_gains_of_single_channels_are_undone_within_the_error_of_the_measure(person: PersonCapture) -> None:
    found = match(colors(person, {1: (0.6, 0.6, 0.6), 4: (1.0, 1.0, 0.5)}))
    assert found is not None
    # Steps of 0.05..0.1 stops come from shape, texture and gloss.
    np.testing.assert_allclose(np.log2(found.gains[1]), -np.log2(0.6), atol=0.25)
    assert np.log2(found.gains[4, 2]) == pytest.approx(1.0, abs=0.3)
    assert np.abs(np.log2(found.gains[[0, 2, 3, 5]])).max() < 0.25


def test_all_cameras_twice_as_bright_agree_as_before(person: PersonCapture) -> None:
    seen = colors(person)
    one, two = match(seen), match(seen / 2)
    assert one is not None
    assert two is not None
    np.testing.assert_allclose(one.gains, two.gains, atol=1e-6)


def test_groups_that_see_different_sides_are_brought_together_each_by_itself() -> None:
    rng = np.random.default_rng(0)
    seen = np.zeros((5, PATCHES, 3), np.float32)
    front, back = np.arange(PATCHES) % DIRECTIONS < 8, np.arange(PATCHES) % DIRECTIONS >= 8
    base = rng.uniform(0.1, 0.4, (PATCHES, 3))
    for v, (side, gain) in enumerate(((front, 1.0), (front, 2.0), (back, 1.0), (back, 0.5))):
        seen[v, side] = (base * gain)[side]
    found = match(seen)
    assert found is not None
    np.testing.assert_allclose(np.log2(found.gains), np.outer([0.5, -0.5, -0.5, 0.5, 0.0], np.ones(3)), atol=1e-5)
    assert match(seen[[0, 2]]) is None
    assert match(seen[:1]) is None


def test_a_difference_within_its_error_is_left_alone() -> None:
    rng = np.random.default_rng(1)
    seen = rng.uniform(0.05, 0.5, (2, PATCHES, 3)).astype(np.float32)  # as good as no common surface
    found = match(seen)
    assert found is not None
    for v in range(2):
        assert found.proven[v] > 0 or (found.gains[v] == 1).all()
    assert found.proven.max() < 1


def test_patches_lie_around_the_limbs_outwards(person: PersonCapture) -> None:
    points, directions, radii = patch_points(person.joints3d[0], person.rig)
    assert points.shape == directions.shape == (PATCHES, 3)
    shown = radii > 0
    assert 0.4 * PATCHES < shown.sum() < 0.8 * PATCHES
    joints = np.repeat(person.joints3d[0, JOINTS, :3], DIRECTIONS, axis=0)
    np.testing.assert_allclose(np.linalg.norm(points - joints, axis=1)[shown], radii[shown], atol=1e-12)
    assert np.abs(directions[:, 2]).max() < 0.2, "nearly horizontal: the cameras' mean upward axis is the person's but for their tilt"
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


def test_the_gain_of_one_changes_no_value_and_tables_are_monotone() -> None:
    np.testing.assert_array_equal(gain_table(np.ones(3))[0], np.arange(256)[:, None].repeat(3, 1))
    for gain in (0.3, 3.0):
        table = gain_table(np.full(3, gain))[0].astype(int)
        assert (np.diff(table, axis=0) >= 0).all()
        # Float32 against float64: a value on the edge may round the other way.
        np.testing.assert_allclose(table[:, 0], to_display(np.clip(to_linear(np.arange(256)) * gain, 0, 1)[:, None].repeat(3, 1)[None])[0, :, 0], atol=1)


class Unreadable(Pictures):
    def read(self, view: int, numbers: object) -> object:  # type: ignore[override]
        raise AssertionError("a picture was decoded")


@pytest.mark.parametrize("asked", [frozenset({MOTION}), frozenset()])
def test_pictures_are_not_decoded_for_what_joints_tell(asked: frozenset[str]) -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    pictures = Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2)
    sources = {"pictures": pictures, "joints": Joints(person.joints2d[:, 0])}
    out = run_stage(STAGE, SurveyParams(), {}, person.rig, Views(person.rig.names, (0, 1), ()), 8, view=0, sources=sources, facts=frozenset({"joints2d"}) | asked)
    assert set(out) == {"survey/sample"} | asked
    if asked:
        assert out[MOTION][0, 2] > 0


def test_nothing_follows_from_a_view_that_is_no_source() -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    sources = {"pictures": Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2), "joints": Joints(person.joints2d[:, 0])}
    out = run_stage(STAGE, SurveyParams(), {}, person.rig, Views(person.rig.names, (1,), (0,)), 8, view=0, sources=sources, facts=frozenset({"joints2d", MOTION, COLORS}))
    assert not out[MOTION].any()
    assert not out[COLORS].any()
