"""Laws of left and right: what was exchanged comes back exactly, what was not stays bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.pose.left_right_swaps import (
    ARMS,
    HEAD,
    LEGS,
    Sides,
    Sighting,
    between_frames,
    between_views,
    mended,
)
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import JOINT_SETS
from tests.support.walking_skeleton import SKELETON, pixels, ring, walk

SIDES = Sides.of("coco17")
WHOLE, ONLY_ARMS, ONLY_LEGS = np.array([[True, True, True], [True, False, False], [False, True, False]])
REACH = 4


def turning(frames: int, degrees: float = 12.0) -> np.ndarray:
    """[F, 17, 3] somebody who turns round on the spot."""
    a = np.deg2rad(degrees) * np.arange(frames)
    turn = np.array(
        [[np.cos(a), -np.sin(a), 0 * a], [np.sin(a), np.cos(a), 0 * a], [0 * a, 0 * a, 1 + 0 * a]]
    ).transpose(2, 0, 1)
    return np.einsum("fab,jb->fja", turn, SKELETON)


def crossed(frames: int) -> np.ndarray:
    """[F, 17, 3] arms crossed before the chest: every wrist is on the other side."""
    out = walk(frames).copy()
    out[:, 7:11] += np.array([[0.2, -0.12, 0.02], [0.2, 0.12, 0.02], [0.15, -0.55, 0.3], [0.15, 0.55, 0.34]])
    return out


def striding(frames: int) -> np.ndarray:
    """[F, 17, 3] legs that pass each other."""
    out = walk(frames).copy()
    for side, sign in ((0, 1), (1, -1)):
        swing = sign * 0.35 * np.sin(2 * np.pi * np.arange(frames) / 16)
        out[:, 13 + side, 0] += 0.5 * swing
        out[:, 15 + side, 0] += swing
    return out


def looked_at(rig: Rig, given: np.ndarray) -> list[Sighting]:
    return [between_views(rig, joints, SIDES, 0.2, 0.02) for joints in given]


def mend(rig: Rig, given: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joints [F, V, 17, 3], points [F, 17, 4] and what was exchanged [F, V, 3] of all frames."""
    seen = looked_at(rig, given)
    done = [mended(rig, seen, f, REACH, SIDES, 0.2, 0.02) for f in range(len(seen))]
    joints, points, exchanged = (np.stack([d[i] for d in done]) for i in range(3))
    return joints, points, exchanged


def noisy(rig: Rig, points: np.ndarray, sigma: float = 1.0) -> np.ndarray:
    out = pixels(rig, points)
    out[..., :2] += np.random.default_rng(7).normal(0, sigma, out[..., :2].shape)
    out[..., 2] = 0.9
    return out


MOTIONS = {
    "walk": striding,
    "turning": turning,
    "turning fast": lambda n: turning(n, 40.0),
    "crossed arms": crossed,
    "still": lambda n: np.repeat(SKELETON[None], n, axis=0),
}


@pytest.mark.parametrize("id", JOINT_SETS)
def test_parts_are_closed_under_mirroring_and_hold_every_two_sided_joint_once(id: str) -> None:
    sides = Sides.of(id)
    np.testing.assert_array_equal(sides.parts[:, sides.flips], sides.parts)
    np.testing.assert_array_equal(sides.parts.sum(axis=0), sides.flips != np.arange(len(sides.flips)))
    assert sides.parts[[ARMS, LEGS]].any(axis=1).all()


@pytest.mark.parametrize("parts", [WHOLE, ONLY_ARMS, ONLY_LEGS])
def test_exchanging_twice_is_nothing(parts: np.ndarray) -> None:
    joints = pixels(ring(3), walk(2))
    np.testing.assert_array_equal(SIDES.exchange(SIDES.exchange(joints, parts), parts), joints)


@pytest.mark.parametrize("views", [2, 4, 8])
@pytest.mark.parametrize("motion", MOTIONS)
def test_without_a_swap_nothing_changes_by_a_bit(motion: str, views: int) -> None:
    """Also seen exactly from the side: two of the ring's cameras look along the line through both hips."""
    rig = ring(views, size=512)
    given = noisy(rig, MOTIONS[motion](9), 1.0)
    joints, points, exchanged = mend(rig, given)
    assert not exchanged.any()
    assert joints.tobytes() == given.tobytes()
    assert points.tobytes() == np.stack([triangulate(rig, g, 0.2, 0.02) for g in given]).tobytes()


@pytest.mark.parametrize("parts", [WHOLE, ONLY_ARMS, ONLY_LEGS])
@pytest.mark.parametrize("swapped", [(1,), (0, 5), (2, 3, 7)])
def test_a_minority_of_views_comes_back_exactly(parts: np.ndarray, swapped: tuple[int, ...]) -> None:
    rig, points = ring(8, size=512), turning(3, 25.0) + np.array([0.2, 0.1, 0.0])
    exact = pixels(rig, points)
    given = exact.copy()
    given[:, list(swapped)] = SIDES.exchange(exact[:, list(swapped)], parts)
    joints, found, exchanged = mend(rig, given)
    np.testing.assert_array_equal(joints, exact)
    np.testing.assert_allclose(found[..., :3], points, atol=1e-6)
    assert exchanged.sum() == 3 * len(swapped) * parts.sum()


@pytest.mark.parametrize("parts", [WHOLE, ONLY_ARMS, ONLY_LEGS])
@pytest.mark.parametrize("views", [range(8), range(4), range(5)])
@pytest.mark.parametrize("frames", [(0,), (4,), (3, 4), (8,)])
def test_neighbours_decide_where_all_half_or_most_views_of_a_frame_are_wrong(
    parts: np.ndarray, views: range, frames: tuple[int, ...]
) -> None:
    rig, points = ring(8, size=512), striding(9) + np.array([0.15, 0.1, 0.0])
    exact = pixels(rig, points)
    given = exact.copy()
    for f in frames:
        given[f, list(views)] = SIDES.exchange(exact[f, list(views)], parts)
    joints, found, exchanged = mend(rig, given)
    np.testing.assert_array_equal(joints, exact)
    np.testing.assert_allclose(found[..., :3], points, atol=1e-6)
    assert np.flatnonzero(exchanged.any(axis=(1, 2))).tolist() == list(frames)


def test_a_swap_of_somebody_small_in_a_large_picture_is_found() -> None:
    rig, points = ring(8, size=4096, focal=0.0625), turning(3, 25.0)
    exact = pixels(rig, points)
    given = exact.copy()
    given[:, [0, 5]] = given[:, [0, 5]][..., SIDES.flips, :]
    joints, found, exchanged = mend(rig, given)
    np.testing.assert_array_equal(joints, exact)
    np.testing.assert_allclose(found[..., :3], points, atol=1e-6)
    assert exchanged.sum() == 3 * 2 * 3


def test_swaps_under_noise_leave_the_joints_where_they_are() -> None:
    rig, points = ring(8, size=512), striding(24)
    clean = noisy(rig, points, 2.0)
    given, rng = clean.copy(), np.random.default_rng(3)
    for f in range(24):
        for v in rng.permutation(8)[: rng.integers(0, 4)]:
            given[f, v] = SIDES.exchange(clean[f, v], (WHOLE, ONLY_LEGS, ONLY_ARMS)[rng.integers(3)])
    _, points_clean, _ = mend(rig, clean)
    _, found, _ = mend(rig, given)
    assert np.linalg.norm(found[..., :3] - points_clean[..., :3], axis=-1).max() < 0.03


def test_even_evidence_changes_nothing() -> None:
    """One frame, half of the views against the other half: nobody knows who is right."""
    rig = ring(8, size=512)
    given = pixels(rig, walk(1))
    given[:, :4] = SIDES.exchange(given[:, :4], WHOLE)
    joints, points, exchanged = mend(rig, given)
    assert not exchanged.any()
    assert joints.tobytes() == given.tobytes()
    assert points.tobytes() == triangulate(rig, given[0], 0.2, 0.02)[None].tobytes()


def test_a_frame_depends_on_those_within_reach_only() -> None:
    rig = ring(5, size=256)
    given = noisy(rig, striding(14), 1.0)
    given[3] = SIDES.exchange(given[3], WHOLE)
    given[9, :2] = SIDES.exchange(given[9, :2], ONLY_LEGS)
    seen = looked_at(rig, given)
    for at in range(14):
        first, last = max(0, at - REACH), min(14, at + REACH + 1)
        np.testing.assert_array_equal(
            between_frames(seen[first:last], at - first, REACH, SIDES), between_frames(seen, at, REACH, SIDES)
        )


def test_the_head_stays_where_it_was_named_rightly() -> None:
    rig = ring(8, size=512)
    exact = pixels(rig, striding(5))
    given = exact.copy()
    given[2, 3] = SIDES.exchange(exact[2, 3], np.array([True, True, False]))
    joints, _, exchanged = mend(rig, given)
    np.testing.assert_array_equal(joints, exact)
    assert exchanged[2, 3].tolist() == [True, True, False]
    assert not exchanged[..., HEAD].any()
    assert LEGS in np.flatnonzero(exchanged[2, 3])


def test_nobody_and_one_view_pass() -> None:
    for rig in (ring(1), ring(4)):
        nobody = np.zeros((3, len(rig), 17, 3))
        joints, points, exchanged = mend(rig, nobody)
        assert not joints.any()
        assert not points.any()
        assert not exchanged.any()
    alone = pixels(ring(1), walk(3))
    np.testing.assert_array_equal(mend(ring(1), alone)[0], alone)
