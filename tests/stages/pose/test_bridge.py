"""Laws of bridging: windows decide, gaps close, what is known stays, what cannot be goes."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.pose.bridge import Bones, bridge, rejected
from posegaussian.storage.model.joint_sets import JOINT_SETS, joint_set
from tests.support.walking_skeleton import SKELETON, pixels, ring

BONES = Bones.of("coco17")
RIG = ring(4, size=512)
REACH = 6
LELBOW, LWRIST, RKNEE, RANKLE = 7, 9, 14, 16


def swinging(frames: int) -> np.ndarray:
    """[F, 17, 4] a walking person whose arms and legs swing about shoulders, elbows,
    hips and knees, 30 frames a second."""
    out = np.concatenate([np.repeat(SKELETON[None], frames, axis=0), np.full((frames, 17, 1), 0.9)], axis=-1)
    t = np.arange(frames) / 30
    for root, below, size, shift in (
        (5, (7, 9), 0.5, 0.0),
        (6, (8, 10), 0.5, 0.5),
        (7, (9,), 0.3, 0.1),
        (11, (13, 15), 0.4, 0.5),
        (12, (14, 16), 0.4, 0.0),
        (14, (16,), 0.4, 0.2),
    ):
        angle = size * np.sin(2 * np.pi * (t + shift))
        c, s = np.cos(angle), np.sin(angle)
        for j in below:
            x, z = (out[:, j, a] - out[:, root, a] for a in (0, 2))
            out[:, j, 0], out[:, j, 2] = out[:, root, 0] + c * x - s * z, out[:, root, 2] + s * x + c * z
    out[..., 0] += 1.2 * t[:, None]
    return out


def bridged(points: np.ndarray, joints: np.ndarray | None = None, reach: int = REACH) -> np.ndarray:
    """All frames, each from its own window; nobody is seen in pictures unless given, [F, V, 17, 3]."""
    seen = np.zeros((len(points), len(RIG), 17, 3)) if joints is None else joints
    return np.stack([bridge(RIG, seen[f], points, f, reach, BONES, 0.2) for f in range(len(points))])


def without(points: np.ndarray, joint: int, frames: slice) -> np.ndarray:
    out = points.copy()
    out[frames, joint] = 0
    return out


@pytest.mark.parametrize("id", JOINT_SETS)
def test_every_joint_comes_after_its_parent(id: str) -> None:
    bones = Bones.of(id)
    assert sorted(bones.order) == list(range(len(joint_set(id))))
    assert all(p < 0 or bones.order.index(p) < bones.order.index(j) for j, p in enumerate(bones.parents))
    names = joint_set(id).names
    assert names[bones.parents[names.index("LWrist")]] == "LElbow"
    assert names[bones.parents[names.index("RAnkle")]] == "RKnee"


def test_no_gap_nothing_changes_by_a_bit() -> None:
    points = swinging(24)
    points[..., :3] += np.random.default_rng(0).normal(0, 0.008, points[..., :3].shape)
    assert not rejected(points, BONES).any()
    assert bridged(points).tobytes() == points.tobytes()


@pytest.mark.parametrize(("gap", "millimetres"), [(1, 1.5), (2, 3.0), (4, 12.0)])
@pytest.mark.parametrize("joint", [LELBOW, LWRIST, RKNEE, RANKLE])
def test_a_gap_in_a_walk_closes_to_some_millimetres(joint: int, gap: int, millimetres: float) -> None:
    points = swinging(30)
    found = bridged(without(points, joint, slice(12, 12 + gap)))
    assert np.linalg.norm(found[..., :3] - points[..., :3], axis=-1).max() < millimetres / 1000
    others = np.delete(np.arange(17), joint)
    np.testing.assert_array_equal(found[:, others], points[:, others])


def test_bones_keep_their_length_and_children_follow() -> None:
    """A whole arm is missing: the wrist hangs on the elbow that was itself bridged."""
    points = swinging(30)
    gap = without(without(points, LELBOW, slice(10, 15)), LWRIST, slice(10, 15))
    found = bridged(gap)
    for a, b in ((5, LELBOW), (LELBOW, LWRIST)):
        lengths = np.linalg.norm(found[:, a, :3] - found[:, b, :3], axis=-1)
        np.testing.assert_allclose(lengths, lengths[0], atol=1e-9)
    assert np.linalg.norm(found[..., :3] - points[..., :3], axis=-1).max() < 0.03


def test_the_score_falls_towards_the_middle_of_a_gap() -> None:
    score = bridged(without(swinging(30), LWRIST, slice(10, 15)))[9:16, LWRIST, 3]
    assert (np.diff(score[:4]) < 0).all()
    np.testing.assert_allclose(score, score[::-1])
    np.testing.assert_allclose(score[1], 0.9 * (1 - 1 / (REACH + 1)))
    assert (score > 0).all()


def test_what_no_frame_within_reach_knows_stays_unknown() -> None:
    gap = without(swinging(40), LWRIST, slice(10, 30))
    found = bridged(gap)
    assert not found[16:24, LWRIST].any()
    assert not found[10:30, LWRIST].any()  # an end alone says too little


def test_where_nobody_is_nobody_is_invented() -> None:
    points = swinging(20)
    points[8] = 0
    assert bridged(points).tobytes() == points.tobytes()


@pytest.mark.parametrize("reach", [1, 4, 9])
def test_any_window_that_holds_the_reach_gives_the_same_bytes(reach: int) -> None:
    points = swinging(26)
    rng = np.random.default_rng(1)
    points[..., :3] += rng.normal(0, 0.01, points[..., :3].shape)
    points[rng.random((26, 17)) < 0.15] = 0
    points[7, LWRIST, :3] += 0.6
    joints = pixels(RIG, points[..., :3])
    joints[rng.random(joints.shape[:-1]) < 0.7] = 0
    whole = bridged(points, joints, reach)
    for at in range(26):
        first, last = max(0, at - reach), min(26, at + reach + 1)
        assert (
            bridge(RIG, joints[at], points[first:last], at - first, reach, BONES, 0.2).tobytes() == whole[at].tobytes()
        )


def test_one_view_says_where_and_the_bone_says_how_deep() -> None:
    points = swinging(30)
    joints = np.zeros((30, len(RIG), 17, 3))
    joints[:, 1] = pixels(RIG, points[..., :3])[:, 1]
    gap = without(points, RANKLE, slice(10, 19))
    blind, seen = (
        np.linalg.norm((bridged(gap, j)[..., :3] - points[..., :3])[10:19, RANKLE], axis=-1) for j in (None, joints)
    )
    assert seen.max() < 0.5 * blind.max()
    assert seen.max() < 0.03


def test_one_view_goes_on_where_a_capture_ends_in_an_occlusion() -> None:
    points = swinging(20)
    joints = np.zeros((20, len(RIG), 17, 3))
    joints[:, 1] = pixels(RIG, points[..., :3])[:, 1]
    found = bridged(without(points, LWRIST, slice(17, 20)), joints)
    assert np.linalg.norm((found[..., :3] - points[..., :3])[17:, LWRIST], axis=-1).max() < 0.04
    assert (np.diff(found[16:, LWRIST, 3]) < 0).all()
    far = joints.copy()
    far[17:, 1, LWRIST, :2] += 200  # what is seen is somebody else's
    assert not bridged(without(points, LWRIST, slice(17, 20)), far)[17:, LWRIST].any()


@pytest.mark.parametrize("joint", [LELBOW, LWRIST, RKNEE, RANKLE, 5, 11, 3])
@pytest.mark.parametrize("frames", [(0,), (11,), (11, 12), (23,)])
def test_a_joint_at_the_end_of_bones_of_the_wrong_length_is_rejected_and_no_other(
    joint: int, frames: tuple[int, ...]
) -> None:
    points = swinging(24)
    points[..., :3] += np.random.default_rng(0).normal(0, 0.005, points[..., :3].shape)
    wrong = points.copy()
    wrong[list(frames), joint, :3] += [0.25, 0.3, -0.25]
    found = rejected(wrong, BONES)
    assert found[list(frames), joint].all()
    assert found.sum() == len(frames)
    if 0 < frames[0] < 23:
        assert np.linalg.norm((bridged(wrong)[..., :3] - points[..., :3])[:, joint], axis=-1).max() < 0.05


@pytest.mark.parametrize("wrong", [LELBOW, LWRIST])
def test_of_two_ends_of_a_wrong_bone_the_one_that_fewer_views_agree_on_is_rejected(wrong: int) -> None:
    points = without(swinging(24), 5, slice(11, 12))  # the shoulder is unknown: nothing else tells
    points[11, wrong] += [0.0, 0.5, 0.5, -0.5]
    assert np.argwhere(rejected(points, BONES)).tolist() == [[11, wrong]]


def test_a_jump_away_and_back_is_rejected_where_no_bone_says_so() -> None:
    points = swinging(24)[:, :]
    alone = Bones(np.zeros((0, 2), np.int64), BONES.order, (-1,) * 17)
    points[9, 0, :3] += [0.0, 1.5, 0.0]
    assert np.argwhere(rejected(points, alone)).tolist() == [[9, 0]]
    assert not rejected(
        swinging(24) + np.linspace(0, 30, 24)[:, None, None] * [1, 0, 0, 0], alone
    ).any()  # a body that runs


def test_a_short_capture_judges_no_bone() -> None:
    points = swinging(4)
    points[1, LWRIST, :3] += 0.4
    np.testing.assert_array_equal(bridged(points), points)


def test_frames_of_another_run_say_how_long_bones_are_and_nothing_else() -> None:
    """Who faces the other way after a break has not jumped; a joint that is missing there stays so."""
    points = np.concatenate([np.repeat(SKELETON[None], 13, axis=0), np.full((13, 17, 1), 0.9)], axis=-1)
    points[:, [LELBOW, 8], 1], points[:, [LWRIST, 10], 1] = [0.5, -0.5], [0.8, -0.8]
    points[6, :, :2] *= -1
    points[6, RANKLE] = 0
    points[6, 15, 2] -= 0.4
    nobody, run = np.zeros((len(RIG), 17, 3)), slice(6, 7)
    alone, among = (bridge(RIG, nobody, points, 6, REACH, BONES, 0.2, r) for r in (run, slice(None)))
    assert np.abs(among[LWRIST] - points[6, LWRIST]).max() > 0.5, "a wrist that jumps away and back"
    kept = np.ones(17, dtype=bool)
    kept[[15, RANKLE]] = False
    np.testing.assert_array_equal(alone[kept], points[6, kept])
    assert not alone[~kept].any()
