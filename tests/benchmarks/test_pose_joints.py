"""What the pose benchmark measures with is right."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.pose_joints import CLEAN, SPOILS, Spoil, body_axes, constant_of, measures, off_heatmaps, offsets, spoilt, without_offset
from stages.capture.effects.joint_noise import JointNoise
from stages.pose.heatmaps import draw
from storage.joints import COCO17
from tests.stages.pose.scene import SKELETON, pixels, ring

FLIPS = list(COCO17.flips)


def moving(frames: int) -> np.ndarray:
    """[F, 17, 3] metres: somebody who turns, waves and goes."""
    t = np.arange(frames)
    out = np.repeat(SKELETON[None], frames, axis=0)
    out[:, 9] += np.column_stack([0.1 * np.sin(0.5 * t), 0 * t, 0.2 * np.cos(0.5 * t)])
    c, s = np.cos(0.1 * t), np.sin(0.1 * t)
    turn = np.stack([np.stack([c, -s, 0 * c]), np.stack([s, c, 0 * c]), np.stack([0 * c, 0 * c, 1 + 0 * c])]).transpose(2, 0, 1)
    return np.einsum("fab,fjb->fja", turn, out) + 0.02 * t[:, None, None]


def scored(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def test_a_joint_is_read_off_its_heatmap_to_a_twentieth_of_a_cell() -> None:
    at = np.random.default_rng(0).uniform(40, 88, (1, 17, 2))
    joints = np.concatenate([at, np.full((1, 17, 1), 0.9)], axis=-1)
    maps = draw(joints, np.full((1, 17), 8.0), (128, 128), (32, 32))
    assert np.abs(off_heatmaps(maps)[..., :2] - at).max() < 0.2  # cells are 4 px wide
    assert not off_heatmaps(np.zeros((2, 3, 8, 8), np.float16)).any()


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


def test_lag_error_and_jitter_of_what_is_known() -> None:
    truth = moving(30)
    late = scored(0.7 * truth[1:] + 0.3 * truth[:-1])
    said = measures(late, truth[1:])
    assert said["lag frames"] == pytest.approx(0.3, abs=0.01)
    assert measures(scored(truth + np.array([0.003, 0, 0.004])), truth) == pytest.approx({"known": 1, "MPJPE mm": 5, "median mm": 5, "95 % mm": 5, "jitter mm": 0, "lag frames": 0}, abs=0.2)
    shaken = scored(truth)
    shaken[::2, :, 0] += 0.001
    assert measures(shaken, truth)["jitter mm"] == pytest.approx(2.0)
    assert measures(scored(np.repeat(SKELETON[None], 5, axis=0)), np.repeat(SKELETON[None], 5, axis=0))["lag frames"] is None
    shaken[4, 2] = 0
    assert measures(shaken, truth)["known"] == pytest.approx(1 - 1 / (30 * 17))


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
