"""Cameras that stand otherwise than they are written down are found by joints of a person and turned back; what no turn
mends turns nobody."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.silhouettes.coherence import Standing
from posegaussian.stages.survey.algorithms.joint_standing import standing_by_joints
from posegaussian.storage.model.cameras import Rig
from tests.support.walking_skeleton import SKELETON, moving, pixels, ring

SIZE, FRAMES = 512, 5
LEFT, RIGHT = slice(1, None, 2), slice(2, None, 2)
"""COCO-17: joints of either side behind the nose."""


def detected(rig: Rig, noise: float = 2.0, seed: int = 0) -> np.ndarray:
    """[S, F, 17, 3] joints as a detector finds them: off by px that are alike in all frames, and some that are not."""
    rng = np.random.default_rng(seed)
    seen = pixels(rig, moving(FRAMES)).swapaxes(0, 1)
    seen[..., :2] += noise * (rng.normal(size=(len(rig), 1, 17, 2)) + rng.normal(size=seen[..., :2].shape)) / np.sqrt(2)
    return seen


def written(rig: Rig, px: dict[int, tuple[float, float, float]]) -> tuple[Rig, np.ndarray]:
    """The rig written down with some cameras turned by px about their axes, and the turns that undo it."""
    turns = np.zeros((len(rig), 3))
    for v, by in px.items():
        turns[v] = np.array(by) / rig.intrinsics[v, 0, 0]
    return turned(rig, turns), -turns


def found(rig: Rig, joints: np.ndarray) -> Standing:
    return standing_by_joints(rig, joints.reshape(len(rig), -1, 3))


def nobody(told: Standing) -> bool:
    return not told.turns.any() and not told.wrong and not told.apart.any()


@pytest.mark.parametrize("views", [4, 6, 8, 16])
def test_cameras_that_stand_right_are_not_turned_whatever_the_detector_scatters(views: int) -> None:
    rig = ring(views, SIZE)
    for seed in range(3):
        for noise in (0.0, 3.0):
            assert nobody(found(rig, detected(rig, noise, seed)))


@pytest.mark.parametrize(
    ("views", "px"),
    [
        (4, {2: (0.0, 18.0, 0.0)}),
        (4, {1: (-12.0, 8.0, 20.0)}),
        (6, {1: (0.0, 18.0, 0.0), 4: (0.0, -18.0, 0.0)}),
        (8, {0: (0.0, 18.0, 0.0), 1: (0.0, 18.0, 0.0)}),
        (8, {1: (18.0, 0.0, 0.0), 4: (0.0, 60.0, 0.0)}),
        (16, {3: (0.0, 18.0, 0.0), 4: (14.0, 0.0, 0.0), 11: (0.0, -40.0, 10.0)}),
        (48, {20: (0.0, 18.0, 0.0)}),
    ],
    ids=["one of four", "all axes", "two apart", "two alike", "two ways", "three of sixteen", "one of many"],
)
def test_cameras_that_are_turned_are_turned_back(views: int, px: dict[int, tuple[float, float, float]]) -> None:
    """To the mean of what the detector errs by at 17 joints, 0.4 px, and the same again of the points; exactly without
    noise."""
    rig, back = written(right := ring(views, SIZE), px)
    for noise, most in ((2.0, 2.0), (0.0, 0.01)):
        told = found(rig, detected(right, noise))
        assert set(np.flatnonzero(told.turns.any(axis=1))) == set(np.flatnonzero(told.apart)) == set(px)
        assert not told.wrong
        assert told.by_joints
        off = (told.turns - back) * rig.intrinsics[:, 0, 0][:, None]
        assert np.abs(off[:, :2]).max() < most
        assert np.abs(off[:, 2]).max() < 4 * most, "a roll moves what is beside the middle alone"


def test_a_small_turn_behind_a_large_one_is_found_too() -> None:
    rig, _ = written(right := ring(9, SIZE), {2: (0.0, 70.0, 0.0), 6: (0.0, 14.0, 0.0)})
    assert set(np.flatnonzero(found(rig, detected(right)).apart)) == {2, 6}


@pytest.mark.parametrize("views", [6, 16])
def test_what_no_turn_mends_turns_nobody(views: int) -> None:
    """Limbs exchanged in one view, another moment of somebody who turns and goes, somebody else elsewhere."""
    rig = ring(views, SIZE)
    exchanged = detected(rig)
    exchanged[2, :, LEFT], exchanged[2, :, RIGHT] = exchanged[2, :, RIGHT].copy(), exchanged[2, :, LEFT].copy()
    assert nobody(found(rig, exchanged))
    late = detected(rig)
    late[2] = pixels(rig, moving(FRAMES + 12)[12:])[:, 2]
    assert nobody(found(rig, late))
    else_where = detected(rig)
    else_where[2] = pixels(rig, SKELETON[None] * [1, 1, 0.7] + [[[0.5, 0.4, 0.0]]])[:, 2]
    assert nobody(found(rig, else_where))


def test_the_order_of_cameras_and_the_size_of_pictures_are_indifferent() -> None:
    rig, _ = written(right := ring(8, SIZE), {1: (18.0, 0.0, 0.0), 4: (0.0, 60.0, 0.0)})
    joints = detected(right)
    told, order = found(rig, joints), np.random.default_rng(1).permutation(8)
    other = found(rig.subset([int(v) for v in order]), joints[order])
    np.testing.assert_allclose(other.turns, told.turns[order], atol=1e-9)
    np.testing.assert_allclose(other.apart, told.apart[order], atol=1e-6)


def test_joints_that_are_few_or_not_believed_tell_nothing() -> None:
    rig, _ = written(right := ring(8, SIZE), {1: (18.0, 0.0, 0.0)})
    joints = detected(right)
    unsure = joints.copy()
    unsure[1, ..., 2] = 0.1
    assert nobody(found(rig, unsure))
    few = joints.copy()
    few[1, :, 2:, 2] = 0.0
    assert nobody(found(rig, few))
    assert nobody(found(rig, np.zeros_like(joints)))
    missing = joints.copy()
    missing[1, 2:, :, 2] = 0.0
    assert set(np.flatnonzero(found(rig, missing).apart)) == {1}


def test_of_three_cameras_nobody_can_tell() -> None:
    rig, _ = written(right := ring(3, SIZE), {1: (18.0, 0.0, 0.0)})
    assert nobody(found(rig, detected(right)))
