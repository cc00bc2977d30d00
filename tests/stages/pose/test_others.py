"""Everybody else who is followed is triangulated too; what a view saw of the subject is nobody else's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.facts import ESTIMATED, TRACKED
from posegaussian.stages.geometry.points import project
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.memory_inputs import run_stage

VIEWS, FRAMES, SIZE = 5, 3, 320
BESIDE = np.array([0.3, 0.5, 0.0])
LEGS = [j for j, n in enumerate(COCO17.names) if n[1:] in ("Hip", "Knee", "Ankle")]


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(VIEWS, SIZE, FRAMES, 0)


def found(person: PersonCapture, moved: np.ndarray) -> dict[str, np.ndarray]:
    """The subject, person1, found second and somebody who stands elsewhere, person2, found first."""
    joints = np.zeros((FRAMES, VIEWS, 2, 17, 3), np.float32)
    joints[:, :, 1] = person.joints2d
    pixels, _ = project(person.rig, person.joints3d[..., :3] + moved)
    joints[:, :, 0, :, :2], joints[:, :, 0, :, 2] = np.moveaxis(pixels, 2, 1), 1
    return {
        "detection/joints2d": joints,
        "people/number": np.tile(np.array([1, 0], np.int16), (FRAMES, VIEWS, 1)),
        "tracks/choice": np.array([0, 0, 2], np.int16),
    }


def others(person: PersonCapture, arrays: dict[str, np.ndarray], length: int | None = None) -> np.ndarray:
    """pose/others3d [F, 16, 17, 4]."""
    facts = frozenset({"joints2d", "several_frames", ESTIMATED, TRACKED})
    more: dict[str, Any] = {"facts": facts, "effects": frozenset()}
    return run_stage(STAGE, PoseParams(), arrays, person.rig, person.views, FRAMES, length, **more)["pose/others3d"]


def test_everybody_but_the_subject_is_triangulated_by_number(person: PersonCapture) -> None:
    arrays = found(person, BESIDE)
    told = others(person, arrays)
    assert (told[:, 1, :, 3] > 0).mean() > 0.95
    known = told[:, 1, :, 3] > 0
    assert np.abs(told[:, 1, :, :3] - person.joints3d[..., :3] - BESIDE)[known].max() < 0.005
    assert not np.delete(told, 1, axis=1).any()
    np.testing.assert_array_equal(others(person, arrays, 1), told)


def test_where_one_person_is_followed_nobody_else_is(person: PersonCapture) -> None:
    arrays = found(person, BESIDE)
    arrays["people/number"][..., 0] = -1
    assert not others(person, arrays).any()


def test_legs_that_a_view_saw_of_the_subject_are_not_somebody_else_s(person: PersonCapture) -> None:
    arrays = found(person, BESIDE)
    seen = arrays["detection/joints2d"]
    seen[:, :2, 0, LEGS] = seen[:, :2, 1, LEGS]  # two views give both people the subject's legs, and agree
    seen[:, 2:, 0, LEGS, 2] = 0.0
    told = others(person, arrays)
    assert not told[:, 1, LEGS, 3].any()
    assert (np.delete(told[:, 1], LEGS, axis=1)[..., 3] > 0).mean() > 0.95
