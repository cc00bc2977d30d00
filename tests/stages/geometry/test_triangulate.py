"""Laws of robust triangulation: exact without noise, optimal with it, deaf to outliers, honest where it cannot know."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.geometry.points import project
from posegaussian.stages.geometry.triangulation import (
    BODIES,
    FEWEST_TOLD,
    MIN_ANGLE,
    MOST_PAIRS,
    pairs_of,
    triangulate,
    unit_of,
)
from posegaussian.storage.model.cameras import Rig, rigid
from tests.support.walking_skeleton import SKELETON, pixels, ring


def lift(rig: Rig, joints: np.ndarray, max_residual: float = 0.02) -> np.ndarray:
    return triangulate(rig, joints, 0.2, max_residual)


@pytest.mark.parametrize("views", [2, 3, 8])
def test_exact_pictures_give_the_exact_skeleton(views: int) -> None:
    rig = ring(views, degrees=300)  # two views of a full ring would face each other
    out = lift(rig, pixels(rig, SKELETON[None])[0])
    np.testing.assert_allclose(out[:, :3], SKELETON, atol=1e-9)  # float64, a few metres
    np.testing.assert_array_equal(out[:, 3], 1.0)


def test_a_moved_world_moves_the_joints() -> None:
    rng = np.random.default_rng(0)
    rig = ring(5)
    seen = pixels(rig, SKELETON[None])[0]
    seen[..., :2] += rng.normal(0, 1.0, seen[..., :2].shape)
    motion = rigid(np.linalg.qr(rng.normal(size=(3, 3)))[0], np.array([40.0, -25.0, 3.0]))
    moved = Rig(rig.names, rig.intrinsics, rig.distortion, rig.world_to_camera @ np.linalg.inv(motion), rig.size)
    expected = lift(rig, seen)[:, :3] @ motion[:3, :3].T + motion[:3, 3]
    # Gauss-Newton stops after six steps in either world
    np.testing.assert_allclose(lift(moved, seen)[:, :3], expected, atol=1e-6)


def test_the_result_is_the_minimum_of_the_weighted_reprojection_error() -> None:
    rng = np.random.default_rng(1)
    rig = ring(6)
    seen = pixels(rig, SKELETON[None])[0]
    seen[..., :2] += rng.normal(0, 0.8, seen[..., :2].shape)
    seen[..., 2] = rng.uniform(0.3, 1.0, seen.shape[:2])
    found = lift(rig, seen, 0.5)[:, :3]

    def cost(points: np.ndarray) -> np.ndarray:
        off = np.moveaxis(project(rig, points)[0], 1, 0) - seen[..., :2]
        return (seen[..., 2] * (off**2).sum(-1)).sum(0)

    for axis in np.eye(3):
        for step in (-1e-3, 1e-3):  # a millimetre to any side is worse
            assert (cost(found + step * axis) > cost(found)).all()
        slope = (cost(found + 1e-5 * axis) - cost(found - 1e-5 * axis)) / 2e-5
        # px^2 per metre, where the curvature is ~1e5 px^2 / m^2: within 10 micrometres
        assert np.abs(slope).max() < 1.0


def test_outliers_are_rejected_and_cost_score() -> None:
    rig = ring(8)
    seen = pixels(rig, SKELETON[None])[0]
    seen[2, :, :2] += 40.0  # 16 % of the longest side
    seen[5, 3, :2] -= 25.0
    seen[6, 4, 2] = 0.1  # below min_score: not seen at all
    out = lift(rig, seen)
    np.testing.assert_allclose(out[:, :3], SKELETON, atol=1e-9)
    expected = np.full(17, 7 / 8)
    expected[3], expected[4] = 6 / 8, 6 / 7
    np.testing.assert_allclose(out[:, 3], expected)


def test_a_wrong_joint_of_somebody_small_in_a_large_picture_is_an_outlier_as_of_somebody_large() -> None:
    for size, focal in ((256, 1.0), (2048, 0.125), (4096, 0.0625)):  # the same pixels of a person in larger pictures
        rig = ring(8, size=size, focal=focal)
        seen = pixels(rig, SKELETON[None])[0]
        assert np.ptp(seen[0, :, 1]) == pytest.approx(155, abs=15)
        seen[2, 9, :2] += 24.0  # a sixth of the person; 1.2 % and 0.6 % of the larger pictures
        out = lift(rig, seen)
        np.testing.assert_allclose(out[:, :3], SKELETON, atol=1e-9)
        assert out[9, 3] == pytest.approx(7 / 8)


def test_residuals_of_who_fills_a_fifth_of_the_picture_are_shares_of_the_picture_by_the_bit() -> None:
    rig, views = ring(3, size=1000), np.arange(3)
    joints = np.zeros((3, 17, 3))
    joints[..., 2] = 0.9
    joints[0, 0, :2], joints[1, 0, :2], joints[2, 0, :2] = (0.0, 200.0), (160.0, 120.0), (0.0, 199.0)
    np.testing.assert_array_equal(unit_of(rig, views, joints, 0.2), [1000.0, 1000.0, BODIES * 199.0])
    joints[2, FEWEST_TOLD - 1 :, 2] = 0.1  # three joints tell nothing of how large somebody is
    assert unit_of(rig, views, joints, 0.2)[2] == 1000.0
    assert unit_of(rig, views, np.zeros((3, 17, 3)), 0.0)[0] == 1000.0  # nor does a single point


def test_score_is_mean_inlier_score_times_inlier_share() -> None:
    rig = ring(4)
    seen = pixels(rig, SKELETON[None])[0]
    seen[:, :, 2] = np.array([0.9, 0.5, 0.7, 0.8])[:, None]
    seen[3, :, :2] += 60.0
    np.testing.assert_allclose(lift(rig, seen)[:, 3], (0.9 + 0.5 + 0.7) / 3 * 3 / 4)


def test_one_view_or_two_that_disagree_know_nothing() -> None:
    rig = ring(3, degrees=200)
    seen = pixels(rig, SKELETON[None])[0]
    alone = seen.copy()
    alone[1:, :, 2] = 0
    assert not lift(rig, alone).any()
    assert not lift(rig.subset([0]), seen[:1]).any()
    seen[2, :, 2] = 0
    seen[1, :, 1] += 60.0  # across the epipolar lines
    assert not lift(rig, seen).any()


def test_rays_that_diverge_meet_behind_the_cameras_and_are_refused() -> None:
    # left camera, right camera, both look along z
    poses = np.stack([rigid(np.eye(3), [0.5, 0, 0]), rigid(np.eye(3), [-0.5, 0, 0])])
    k = np.tile(np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]]), (2, 1, 1))
    rig = Rig(("left", "right"), k, np.zeros((2, 8)), poses, np.full((2, 2), 100))
    apart = np.array([[[30.0, 50.0, 1.0]], [[70.0, 50.0, 1.0]]])
    assert not lift(rig, apart).any()
    together = lift(rig, apart[::-1].copy())
    np.testing.assert_allclose(together[0], [0, 0, 2.5, 1], atol=1e-9)  # f b / d = 100 * 1 / 40


def test_coincident_cameras_say_nothing_about_depth() -> None:
    one = ring(4).subset([0, 0])
    assert not lift(one, pixels(one, SKELETON[None])[0]).any()
    three = ring(4).subset([0, 0, 1])  # but they do not harm a third
    np.testing.assert_allclose(lift(three, pixels(three, SKELETON[None])[0])[:, :3], SKELETON, atol=1e-9)
    assert np.rad2deg(MIN_ANGLE) == pytest.approx(1.0)


def test_pairs_join_different_views_and_are_bounded() -> None:
    for count in (2, 3, 4, 7, 23):
        found = pairs_of(np.arange(count)).tolist()
        assert sorted(found) == [[a, b] for a in range(count) for b in range(a + 1, count)]
    assert sorted(pairs_of(np.array([0, 0, 1])).tolist()) == [[0, 2], [1, 2]]
    assert pairs_of(np.array([0, 0])).shape == pairs_of(np.array([3])).shape == (0, 2)
    many = pairs_of(np.arange(60))
    assert MOST_PAIRS / 2 < len(many) <= MOST_PAIRS
    assert (np.bincount(many.ravel(), minlength=60) >= 7).all()
