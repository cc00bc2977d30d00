"""Views weighed by how sure they are of joints: what it takes away, from whom, where, and when it is on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.facts import JOINTS2D
from posegaussian.stages.contract.judged import GIVEN_MATTE, POSE
from posegaussian.stages.rendering.effects import POSE_BLENDING, SCORES, WORTH
from posegaussian.stages.rendering.pose_blending import NEAR, OMEGA, PAST, Sureness, stabilised

ELBOW, KNEE = np.array([0.3, 0.0, 1.2]), np.array([0.1, 0.0, 0.5])
JOINTS = np.concatenate([np.stack([ELBOW, KNEE]), np.ones((2, 1))], axis=1)


def sureness(*scores: tuple[float, float]) -> Sureness:
    return Sureness(JOINTS, {v: np.array(s) for v, s in enumerate(scores)})


def test_views_that_are_equally_sure_keep_everything() -> None:
    points = np.random.default_rng(0).normal(0, 1, (50, 3))
    for score in (0.0, 0.4, 1.0):
        equal = sureness((score, score), (score, score))
        assert (equal.share(points, 0, [0, 1]) == 1).all()
    assert (sureness((0.1, 0.2)).share(points, 0, [0]) == 1).all(), "a picture of one view"


def test_the_unsure_view_loses_around_the_joint_it_does_not_find_and_the_sure_one_nothing() -> None:
    found = sureness((0.0, 1.0), (1.0, 1.0))
    at = np.stack([ELBOW, KNEE, ELBOW + 3 * NEAR, ELBOW + 50 * NEAR])
    share = found.share(at, 0, [0, 1])
    assert share[0] < 0.05
    assert share[1] > 0.95
    assert share[0] < share[2] < share[3]
    assert share[3] == pytest.approx(1), "where no joint is near all views are alike"
    assert (found.share(at, 1, [0, 1]) == 1).all()


def test_a_joint_that_nobody_knows_says_nothing() -> None:
    unknown = Sureness(JOINTS * [1, 1, 1, 0], {0: np.zeros(2), 1: np.ones(2)})
    assert (unknown.share(JOINTS[:, :3], 0, [0, 1]) == 1).all()


def test_scores_are_stabilised_over_the_frames_before() -> None:
    """A fixed point, the recurrence, and no farther back than is read: partitions change nothing."""
    scores = np.random.default_rng(1).random((9, 3))
    assert stabilised(np.full((7, 2), 0.3)) == pytest.approx(0.3)
    assert (stabilised(scores[-1:]) == scores[-1]).all()
    assert stabilised(scores[-2:]) == pytest.approx(OMEGA * scores[-1] + (1 - OMEGA) * scores[-2])
    assert (stabilised(scores) == stabilised(scores[-1 - PAST :])).all()


def decision(scores: np.ndarray, gain: float | None) -> Any:
    noted = {SCORES: scores}
    if gain is not None:
        drawn = np.full((4, 2, 3), 0.9)
        drawn[:, :, 0] = 25.0
        drawn[:, 1, 0] += gain
        noted[POSE] = drawn
    evidence = SimpleNamespace(noted=noted, sources=(0, 2, 3), facts={JOINTS2D, GIVEN_MATTE})
    return POSE_BLENDING.decide(evidence, POSE_BLENDING.threshold)  # type: ignore[arg-type]


def test_it_is_on_where_views_differ_and_left_out_views_gain() -> None:
    alike, apart = np.full((3, 17), 0.9), np.array([[0.9] * 17, [0.2] * 17, [0.8] * 17])
    assert not decision(alike, None).on, "nothing is drawn to find that out"
    assert decision(alike, None).measured == 0
    assert decision(apart, None) is None, "the judge is asked"
    assert decision(apart, 2 * WORTH).on
    assert not decision(apart, WORTH / 2).on
    assert "views weighed by it" in decision(apart, -1.0).reason
