"""How well a view's joints fit the triangulated ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.depth.effects import LIMB_BOUNDS
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.algorithms.joints import FITTING, fit_of_view, scores_of_view


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=6, size=64, frames=3, held_out=0)


def inputs_of(c: PersonCapture, joints: np.ndarray) -> Any:
    reader = SimpleNamespace(joint_set="coco17", read=lambda v, n: joints[n, v][None])
    return SimpleNamespace(
        facts=frozenset({"joints2d"}),
        views=c.views,
        rig=c.rig,
        source_rig=c.rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (len(c.rig), 1)),
        source=lambda kind: reader,
    )


def fit(c: PersonCapture, joints: np.ndarray, view: int = 0) -> np.ndarray:
    return fit_of_view(inputs_of(c, joints), view, np.arange(len(joints)))


def decided(noted: np.ndarray, facts: frozenset[str] = frozenset({"joints2d"})) -> Any:
    return LIMB_BOUNDS.decide(SimpleNamespace(noted={"survey/joint_fit": noted}, facts=facts), LIMB_BOUNDS.threshold)  # type: ignore[arg-type]


def noisy(c: PersonCapture, pixels: float) -> np.ndarray:
    return c.joints2d + np.random.default_rng(0).normal(size=c.joints2d.shape) * [pixels, pixels, 0]


def test_exact_joints_fit_and_call_for_the_bounds(person: PersonCapture) -> None:
    found = np.stack([fit(person, person.joints2d, v) for v in range(6)])
    assert found[:, 0].max() < 1e-6
    assert (found[:, 1] == 1).all()
    assert (found[:, 2] == 17).all()
    assert decided(found).on


def test_the_median_is_that_of_the_noise_and_noise_beyond_the_bound_switches_off(person: PersonCapture) -> None:
    """White noise of s px in u and v lies 1.18 s from its mean (Rayleigh), and the triangulated point takes a
    quarter of the variance of six views along."""
    small, large = (np.stack([fit(person, noisy(person, s), v) for v in range(6)]) for s in (0.3, 1.5))
    assert 0.2 < np.median(small[:, 0]) * 64 < 0.4
    assert decided(small).on
    # Triangulation itself leaves out what lies 2 % off, 1.3 px at this size: little is left, and that fits badly.
    assert (large[:, 1] < 1).all()
    assert ((large[:, 0] <= FITTING) == (large[:, 1] >= 0.5)).all()
    assert not decided(large).on


def test_joints_that_are_few_or_unknown_switch_off(person: PersonCapture) -> None:
    joints = person.joints2d.copy()
    joints[:, :, 5:, 2] = 0
    few = np.stack([fit(person, joints, v) for v in range(6)])
    assert (few[:, 2] == 5).all()
    assert "too few" in decided(few).reason
    assert not decided(few).on
    assert (fit(person, np.zeros_like(joints)) == 0).all()
    assert not decided(np.zeros((6, 3))).on
    assert "3D alone" in decided(few, frozenset({"joints3d"})).reason


def test_frames_in_which_nobody_is_change_nothing(person: PersonCapture) -> None:
    """Somebody who is there in one frame of five has as many limbs in it as one who stays; a camera that alone sees
    somebody meets nobody's joints."""
    joints = noisy(person, 0.3)[:1]
    gone = np.concatenate([0 * joints, joints, 0 * joints, 0 * joints, 0 * joints])
    gone[3, 2] = joints[0, 2]
    for v in range(6):
        np.testing.assert_array_equal(fit(person, gone, v), fit(person, joints, v))
        scores = [scores_of_view(inputs_of(person, j), v, np.arange(len(j))) for j in (gone, joints)]
        np.testing.assert_array_equal(*scores)
        assert scores[0].any()
    assert decided(np.stack([fit(person, gone, v) for v in range(6)])).on


def test_a_view_that_misses_somebody_whom_the_others_see_has_fewer_joints(person: PersonCapture) -> None:
    joints = person.joints2d.copy()
    joints[1:, 2] = 0
    whole, missing = (fit(person, j, 2)[2] for j in (person.joints2d, joints))
    assert missing == pytest.approx(whole / len(joints))
    assert scores_of_view(inputs_of(person, joints), 2, np.arange(3)).max() <= 1 / 3 + 1e-9


def test_where_nothing_meets_scores_are_those_of_all_frames(person: PersonCapture) -> None:
    alone = np.zeros_like(person.joints2d)
    alone[:, 0] = person.joints2d[:, 0]
    seen = scores_of_view(inputs_of(person, alone), 0, np.arange(len(alone)))
    np.testing.assert_allclose(seen, alone[:, 0, :, 2].mean(axis=0))
