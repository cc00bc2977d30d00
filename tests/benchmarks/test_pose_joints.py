"""What the pose benchmark measures with is right."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.pose.joints import CLEAN, SPOILS, Spoil, body_axes, constant_of, offsets, spoilt, without_offset
from posegaussian.stages.simulator.effects.joint_noise import JointNoise
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.walking_skeleton import SKELETON, moving, pixels, ring, scored

FLIPS = list(COCO17.flips)


def test_axes_are_orthonormal_right_handed_and_turn_with_the_body() -> None:
    axes = body_axes(moving(9))
    np.testing.assert_allclose(axes @ axes.swapaxes(-1, -2), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_allclose(body_axes(SKELETON[None])[0, 5], np.eye(3), atol=0.05)  # it faces x, its left is y


def test_constant_offsets_come_off_again() -> None:
    truth, rng = moving(12), np.random.default_rng(1)
    constant = rng.normal(0, 0.02, (17, 3))
    constant = (constant + constant[FLIPS] * [1, -1, 1]) / 2  # left and right mean the same
    found = without_offset(scored(truth), truth, -constant)
    found[3, 4] = 0.0
    np.testing.assert_allclose(constant_of(offsets(found, truth)), constant, atol=1e-12)
    less = without_offset(found, truth, constant)
    known = found[..., 3] > 0
    np.testing.assert_allclose(less[known][:, :3], truth[known], atol=1e-12)


def test_faults_are_those_that_are_named_and_always_the_same() -> None:
    rig = ring(4, size=256)
    exact = pixels(rig, moving(20))
    exact[:, 1, 9, 2] = 0  # hidden
    np.testing.assert_array_equal(spoilt(exact, SPOILS[-1], 3), spoilt(exact, SPOILS[-1], 3))
    off = spoilt(exact, CLEAN, 3)[..., :2] - exact[..., :2]
    assert off.std() == pytest.approx(1.0, abs=0.05)
    none = JointNoise(pixels=0.0, dropouts=0.0, outliers=0.0)
    turned = spoilt(exact, Spoil("", none, frames_exchanged=1.0), 3)
    np.testing.assert_allclose(turned[..., :2], exact[:, :, FLIPS][..., :2])
    gone = spoilt(exact, Spoil("", none, hidden_missing=1.0), 3)
    np.testing.assert_array_equal(gone[..., 2] > 0, exact[..., 2] > 0)
