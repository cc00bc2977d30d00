"""Cameras that stand otherwise than they are written down are found by joints of a person and turned back; what no turn
mends turns nobody."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.trust import KINDS
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.silhouettes.coherence import Standing
from posegaussian.stages.survey.algorithms.agreement import FEWEST_DETECTED, _by_joints
from posegaussian.stages.survey.algorithms.links import few_of
from posegaussian.stages.survey.measures.agreement import NAME
from posegaussian.stages.survey.measures.contrast import CONTRAST
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.standing.by_joints import same_person_first, standing_by_joints
from posegaussian.stages.survey.standing.standing import standing_in
from posegaussian.stages.survey.trust import believed
from posegaussian.storage.model.cameras import Rig
from tests.support.frame_readers import Pictures
from tests.support.walking_skeleton import SKELETON, Joints2D, moving, pixels, ring, roles

SIZE, FRAMES, APART_IN_TIME = 512, 5, 7
LEFT, RIGHT = slice(1, None, 2), slice(2, None, 2)
"""COCO-17: joints of either side behind the nose."""


def detected(rig: Rig, noise: float = 2.0, seed: int = 0, person: np.ndarray | None = None) -> np.ndarray:
    """[S, F, 17, 3] joints as a detector finds them: off by px that are alike in all frames, and some that are not."""
    rng = np.random.default_rng(seed)
    seen = pixels(rig, moving(FRAMES) if person is None else person).swapaxes(0, 1)
    seen[..., :2] += noise * (rng.normal(size=(len(rig), 1, 17, 2)) + rng.normal(size=seen[..., :2].shape)) / np.sqrt(2)
    return seen


def written(rig: Rig, px: dict[int, tuple[float, float, float]]) -> tuple[Rig, np.ndarray]:
    """The rig written down with some cameras turned by px about their axes, and the turns that undo it."""
    turns = np.zeros((len(rig), 3))
    for v, by in px.items():
        turns[v] = np.array(by) / rig.intrinsics[v, 0, 0]
    return turned(rig, turns), -turns


def found(rig: Rig, joints: np.ndarray, *others: np.ndarray) -> Standing:
    """Of [S, F, 17, 3] joints of each camera's largest person, and of others, in frames seven apart."""
    return standing_by_joints(rig, np.stack([joints, *others], axis=2), APART_IN_TIME * np.arange(joints.shape[1]))


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
    """Limbs exchanged in one view, another moment of somebody who turns and goes, a child elsewhere."""
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


def walker(late: int = 0) -> np.ndarray:
    """[F, 17, 3] metres: somebody who walks straight on at 1.4 m/s, filmed by 25 frames a second, frames seven apart,
    so many frames late; arms and legs swing."""
    t = (APART_IN_TIME * np.arange(FRAMES) + late) / 25
    out = np.repeat(SKELETON[None], FRAMES, axis=0)
    out[:, :, 1] += 1.4 * (t - 0.6)[:, None]
    for joint, sign, reach in ((9, 1, 0.25), (10, -1, 0.25), (7, 1, 0.1), (8, -1, 0.1), (15, -1, 0.3), (16, 1, 0.3)):
        out[:, joint, 1] += sign * reach * np.sin(2 * np.pi * t)
    return out


def swinging(numbers: np.ndarray) -> np.ndarray:
    """[F, 17, 3] metres: the same walker in single frames, twelve and a half a second."""
    return np.stack([walker(2 * int(n))[0] for n in numbers])


LONG, SAMPLED = 28, np.arange(4, 24, 3)


def late_of(by: float, noise: float, camera: int = 1, bumped: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Standing:
    """How six cameras stand by joints that came with the capture, of which one is so many frames late, and bumped."""
    rig, _ = written(right := ring(6, SIZE, radius=3.5), {camera: bumped})
    seen = detected(right, noise, 0, swinging(np.arange(LONG)))
    # Of half a frame the picture shows what lies between two of a camera that films at twice the rate.
    moments = swinging(np.arange(LONG) - int(np.floor(by))), swinging(np.arange(LONG) - int(np.ceil(by)))
    seen[camera] = detected(right, noise, 1, np.mean(moments, axis=0))[camera]
    return given(rig, seen)


def given(rig: Rig, seen: np.ndarray, numbers: np.ndarray = SAMPLED) -> Standing:
    """How cameras stand by joints [S, LONG, 17, 3] that came with the capture, in frames `numbers`."""
    inputs: Any = SimpleNamespace(
        facts=frozenset({"joints2d"}),
        views=roles(rig),
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (len(rig), 1)),
        source=lambda kind: Joints2D.single(seen.swapaxes(0, 1)),
    )
    return standing_in(inputs, numbers)


def test_cameras_without_a_frame_in_common_are_believed() -> None:
    """Each lacks another one, or their files are numbered differently: there is nothing to compare."""
    rig, _ = written(right := ring(6, SIZE), {1: (0.0, 18.0, 0.0)})
    seen = detected(right, person=swinging(np.arange(LONG)))
    assert set(np.flatnonzero(given(rig, seen).apart)) == {1}
    assert nobody(given(rig, seen, SAMPLED[:0]))


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("by", [1, 2, 3, -1, -2])
def test_a_camera_that_is_late_is_told_with_the_frames(by: int, noise: float) -> None:
    told = late_of(by, noise)
    assert dict(told.late) == {1: by}
    assert set(np.flatnonzero(told.apart)) == {1}
    assert not told.turns.any()
    assert not told.wrong


@pytest.mark.parametrize("by", [1.5, 2.5, -1.5])
def test_half_a_frame_is_told_where_neither_frame_fits(by: float) -> None:
    assert dict(late_of(by, 0.0).late) == {1: by}


def test_who_stands_right_or_is_bumped_is_not_late_nor_whose_moment_lies_beyond_those_that_are_asked() -> None:
    for by, bumped in ((0, (0.0, 0.0, 0.0)), (0, (0.0, 18.0, 0.0)), (0, (18.0, 0.0, 0.0)), (6, (0.0, 0.0, 0.0))):
        told = late_of(by, 2.0, bumped=bumped)
        assert not told.late
        assert told.turns.any() == any(bumped)


@pytest.mark.parametrize("wrong", [1, 2, 3])
def test_a_camera_whose_detector_errs_in_some_of_the_frames_is_not_late(wrong: int) -> None:
    """Whatever other frame is asked, joints lie nearer there: a stranger in the frame itself, limbs that are lost."""
    rig = ring(4, SIZE, radius=3.5)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        seen = detected(rig, 2.0, seed, swinging(np.arange(LONG)))
        for n in rng.choice(few_of(SAMPLED), wrong, replace=False):
            seen[1, n, :, :2] += rng.normal(scale=30.0, size=(17, 2)) + rng.normal(scale=40.0, size=2)
        assert not given(rig, seen).late


def test_of_two_people_the_one_whom_views_agree_on_tells_how_cameras_stand() -> None:
    """One camera has the other one as the largest, in some frames or in all: as it is written down it sees the one."""
    rig, largest = ring(4, SIZE, radius=3.5), slice(1, 4)
    person, other = (detected(rig, 2.0, 0, moving(FRAMES) + at) for at in (np.zeros(3), np.array([0.3, -0.7, 0.0])))
    for frames in (slice(None), largest):
        first, second = person.copy(), other.copy()
        first[1, frames], second[1, frames] = other[1, frames], person[1, frames]
        people = same_person_first(rig, np.stack([first, second], axis=2))
        assert np.array_equal(people[:, :, 0], person)
        assert np.array_equal(people[:, :, 1], other)
    bumped, _ = written(rig, {2: (0.0, 60.0, 0.0)})
    seen = np.stack([detected(rig, 2.0), np.zeros_like(other)], axis=2)
    assert np.array_equal(same_person_first(bumped, seen), seen), "whom nobody agrees with stays who is largest"


@pytest.mark.parametrize("views", [4, 6, 8])
def test_a_camera_that_is_late_is_not_turned_after_somebody_who_walks_by(views: int) -> None:
    rig = ring(views, SIZE, radius=3.5)
    for late in (1, 2, 3, 5, 8):
        for noise in (0.0, 2.0):
            joints = detected(rig, noise, late, walker())
            joints[1] = detected(rig, noise, late, walker(late))[1]
            assert nobody(found(rig, joints))


def test_a_camera_that_is_turned_is_turned_back_though_somebody_walks_by() -> None:
    rig, _ = written(right := ring(8, SIZE, radius=3.5), {2: (12.0, 12.0, 0.0)})
    assert set(np.flatnonzero(found(rig, detected(right, 2.0, 0, walker())).apart)) == {2}


def test_where_somebody_else_is_the_largest_nobody_is_turned() -> None:
    """Two people of one build side by side, of whom one camera has the other one as the largest."""
    rig = ring(6, SIZE, radius=3.5, degrees=120.0)
    unseen = set[int]()
    for place in ([0.0, 0.8, 0.0], [0.3, -0.7, 0.0]):
        person, other = (detected(rig, 0.0, 0, moving(FRAMES) + at) for at in (np.zeros(3), np.array(place)))
        joints, others = person.copy(), other.copy()
        joints[1], others[1] = other[1], person[1]
        assert nobody(found(rig, joints, others))
        unseen |= set(np.flatnonzero(found(rig, joints).apart))
    assert unseen == {1}, "were nobody else shown, it would look turned"


def test_given_joints_of_cropped_pictures_turn_nobody() -> None:
    """They may be those of the calibrated picture, where a camera that is cropped looks turned."""
    rig, _ = written(right := ring(8, SIZE), {1: (0.0, 18.0, 0.0)})
    reader = Joints2D.single(detected(right, 0.0).swapaxes(0, 1))
    inputs: Any = SimpleNamespace(
        facts=frozenset({"joints2d"}),
        views=roles(rig),
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (8, 1)),
        source=lambda kind: reader,
    )
    assert set(np.flatnonzero(standing_in(inputs, np.arange(FRAMES)).apart)) == {1}
    inputs.captured_to_calibrated[2] = 1.0, 40.0, 0.0
    assert nobody(standing_in(inputs, np.arange(FRAMES)))


def test_where_masks_show_nobody_joints_tell() -> None:
    """Masks may be there and empty: of frames in which nobody is, or of somebody whom they were not made for."""
    rig, _ = written(right := ring(8, SIZE), {1: (0.0, 18.0, 0.0)})
    readers = {
        "joints": Joints2D.single(detected(right, 0.0).swapaxes(0, 1)),
        "pictures": Pictures([[np.zeros((SIZE, SIZE, 3), np.uint8)] * FRAMES] * 8),
        "masks": Pictures([[np.zeros((SIZE, SIZE), np.uint8)] * FRAMES] * 8),
    }
    inputs: Any = SimpleNamespace(
        facts=frozenset({"joints2d", "masks"}),
        views=roles(rig),
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (8, 1)),
        source=readers.__getitem__,
    )
    told = standing_in(inputs, np.arange(FRAMES))
    assert told.by_joints
    assert set(np.flatnonzero(told.apart)) == {1}


def test_joints_that_a_detector_found_in_one_of_two_frames_accuse_nobody() -> None:
    rig, _ = written(right := ring(4, SIZE), {1: (40.0, 0.0, 0.0)})
    seen = detected(right, 0.0)
    for frames, found_in in ((1, 1), (2, 1), (2, 2), (4, 2)):
        people = {v: {n: seen[v, n][None] * (n < found_in) for n in range(frames)} for v in (0, 1)}
        assert _by_joints(rig, (0, 1), people, FEWEST_DETECTED) == (0.0, 0)
        assert _by_joints(rig, (0, 1), people, 1)[1] == found_in
    people = {v: {n: seen[v, n][None] for n in range(3)} for v in (0, 1)}
    assert _by_joints(rig, (0, 1), people, FEWEST_DETECTED)[1] == 3


def test_joints_that_a_detector_found_in_one_frame_speak_for_a_camera_whose_mask_alone_accuses_it() -> None:
    """A piece of floor in its mask contradicts all others; of one that is tilted by 1 % of the picture joints say no
    more than its outlines do."""
    right, off = ring(6, SIZE), 0.007
    for rig, left_out in ((right, set()), (written(right, {2: (0.01 * SIZE, 0.0, 0.0)})[0], {2})):
        seen = detected(right)
        people = {v: {0: seen[v, 0][None]} for v in range(6)}
        pairs = np.zeros((6, 6, 3, 2))
        for a, b in combinations(range(6), 2):
            pairs[a, b, KINDS.index("outlines")] = off * (2 in (a, b)), 2
            px, count = _by_joints(rig, (a, b), people, FEWEST_DETECTED)
            pairs[a, b, KINDS.index("joints")] = px / SIZE, count
        noted = {NAME: pairs, STANDING: np.zeros((6, 7)), CONTRAST: np.full(6, 100.0)}
        told = believed(tuple("abcdef"), noted)
        assert {v for v in range(6) if not told[v].believed} == left_out


@pytest.mark.parametrize("estimated", [False, True])
def test_who_sees_somebody_in_few_frames_accuses_nobody_but_by_joints_that_were_given(estimated: bool) -> None:
    rig, _ = written(right := ring(4, SIZE), {1: (40.0, 0.0, 0.0)})
    seen = detected(right, 0.0)
    people = {v: {n: seen[v, n][None] * (n < 2) for n in range(FRAMES)} for v in (0, 1)}
    fewest = FEWEST_DETECTED if estimated else 1
    off, count = _by_joints(rig, (0, 1), people, fewest)
    assert (off > 0, count) == ((False, 0) if estimated else (True, 2))


def test_a_camera_that_looks_away_was_not_bumped() -> None:
    rig, _ = written(right := ring(8, SIZE), {1: (0.0, 0.7 * SIZE, 0.0)})
    assert nobody(found(rig, detected(right)))


def test_the_order_of_cameras_and_the_size_of_pictures_are_indifferent() -> None:
    rig, _ = written(right := ring(8, SIZE), {1: (18.0, 0.0, 0.0), 4: (0.0, 60.0, 0.0)})
    joints = detected(right)
    told, order = found(rig, joints), np.random.default_rng(1).permutation(8)
    other = found(rig.subset([int(v) for v in order]), joints[order])
    np.testing.assert_allclose(other.turns, told.turns[order], atol=1e-9)
    np.testing.assert_allclose(other.apart, told.apart[order], atol=1e-6)


@pytest.mark.parametrize("px", [14.0, 18.0])
def test_where_joints_scatter_by_a_third_of_what_they_lie_beside_in_the_last_frames_nobody_was_moved(px: float) -> None:
    """Somebody who is half hidden then is found beside the place, and a camera turned after them fits a little."""
    rig = ring(4, SIZE)
    for seed in range(8):
        joints = detected(rig, 5.0, seed)
        joints[2, 3:, :, :2] += np.random.default_rng(seed).normal([px, 8.0], 4.0, (17, 2))
        assert not found(rig, joints).moved


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


@pytest.mark.parametrize("since", [2, 3])
@pytest.mark.parametrize(
    ("views", "px"),
    [(4, {2: (0.0, 18.0, 0.0)}), (8, {1: (-12.0, 8.0, 0.0)}), (9, {0: (0.0, 30.0, 0.0), 5: (0.0, -18.0, 0.0)})],
    ids=["one of four", "one of eight", "two of nine"],
)
def test_a_camera_that_was_moved_in_mid_take_is_told_with_the_moment(
    since: int, views: int, px: dict[int, tuple[float, float, float]]
) -> None:
    rig, back = written(right := ring(views, SIZE), px)
    joints = detected(right)
    joints[:, since:] = detected(rig)[:, since:]
    told = found(right, joints)
    assert set(told.moved) == set(px)
    assert not told.turns.any()
    for v, moved in told.moved.items():
        assert (moved.before, moved.after) == (APART_IN_TIME * (since - 1), APART_IN_TIME * since)
        off = (moved.by + back[v]) * right.intrinsics[v, 0, 0]
        assert np.abs(off[:2]).max() < 3.0


def test_a_camera_that_is_wrong_in_a_single_frame_was_not_moved() -> None:
    rig, _ = written(right := ring(8, SIZE), {2: (0.0, 18.0, 0.0)})
    for n in range(FRAMES):
        joints = detected(right)
        joints[:, n] = detected(rig)[:, n]
        assert nobody(told := found(right, joints))
        assert not told.moved


def test_others_are_turned_back_beside_one_that_was_moved() -> None:
    rig, back = written(right := ring(9, SIZE), {4: (0.0, 18.0, 0.0)})
    moved, _ = written(right, {1: (0.0, 25.0, 0.0)})
    joints = detected(right)
    joints[:, 3:] = detected(moved)[:, 3:]
    told = found(rig, joints)
    assert set(told.moved) == {1}
    assert set(np.flatnonzero(told.turns.any(axis=1))) == {4}
    assert np.abs((told.turns - back)[4, :2] * rig.intrinsics[4, 0, 0]).max() < 2.0
