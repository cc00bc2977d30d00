"""Cameras that stand otherwise than they are written down are found by their silhouettes and turned back; what turns
cannot mend turns nobody."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.imaging.small_turns import APART, SIDE, turned
from posegaussian.stages.silhouettes.coherence import FAR, FEWEST, INCOHERENT, STEP, Outlined, Standing, standing
from posegaussian.stages.silhouettes.march import beside, in_sphere, nearest_to, watched
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.cameras import Rig

SIZE = 128
PIXEL = SIZE / SIDE


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    """Eight cameras in a level ring: a camera that is turned along its lines leaves features and joints on them."""
    return capture_person(views=8, size=SIZE, frames=1)


def masks_of(person: PersonCapture, views: int = 8) -> dict[int, np.ndarray]:
    return {v: person.mask[0, v].copy() for v in range(views)}


def written(person: PersonCapture, px: dict[int, tuple[float, float, float]]) -> tuple[Rig, np.ndarray]:
    """The rig written down with some cameras turned by px about their axes, and the turns that undo it."""
    turns = np.zeros((len(person.rig), 3))
    for v, by in px.items():
        turns[v] = np.array(by) / person.rig.intrinsics[v, 0, 0]
    return turned(person.rig, turns), -turns


def found(rig: Rig, *frames: dict[int, np.ndarray]) -> Standing:
    return standing(rig, [Outlined.of(rig, masks) for masks in frames])


def test_exact_cameras_stand_as_they_are_written_down(person: PersonCapture) -> None:
    outlined = Outlined.of(person.rig, masks_of(person))
    mean = np.mean([outlined.excess(person.rig, v).mean() for v in range(8)])
    assert mean < INCOHERENT * PIXEL
    told = found(person.rig, masks_of(person))
    assert not told.turns.any()
    assert not told.wrong
    assert not told.apart.any()


def best_place(outlined: Outlined, origin: np.ndarray, d: np.ndarray, view: int) -> float:
    """Px, as `excess` tells them, with every point of one ray looked at in every view."""
    s = outlined.silhouettes
    others, sides = s.asked(origin, view)
    start, along = s.projections[:, :, :3] @ origin + s.projections[:, :, 3], s.projections[:, :, :3] @ d
    first, last = in_sphere(origin - s.centre, d, s.radius)
    first, last = watched(start, along, s.sizes, others, sides, nearest_to(origin - s.centre, d), 0, first, last)
    best = FAR * PIXEL
    for z in np.arange(first, last, STEP * s.pixel / np.linalg.norm(d)):
        px = [beside(z, v, start, along, s.distance, s.sizes)[0] for v in others]
        best = min(best, max(0.0, *px)) if np.isfinite(px).sum() >= 2 else best
    return best


@pytest.mark.parametrize("px", [(0.0, 4.0, 0.0), (3.0, -15.0, 0.0), (0.0, 0.0, 8.0)])
def test_points_that_are_strided_over_are_no_better(person: PersonCapture, px: tuple[float, float, float]) -> None:
    rig, _ = written(person, {2: px})
    outlined = Outlined.of(rig, masks_of(person))
    origin, directions = rays(outlined.rims[2], rig.intrinsics[2], rig.world_to_camera[2])
    every = [best_place(outlined, origin, d, 2) for d in directions[::3]]
    np.testing.assert_allclose(outlined.excess(rig, 2)[::3], every, atol=1e-9)


def test_nobody_is_turned_where_all_cameras_are_off_by_a_px() -> None:
    """Two of six, turned, would explain it; so do small turns of all, which calibration_correction finds."""
    person = capture_person(views=6, size=SIZE, frames=1)
    px = np.random.default_rng(5).normal(0, 1.2 * PIXEL, (6, 3))
    rig, _ = written(person, {v: tuple(px[v]) for v in range(6)})
    assert not found(rig, masks_of(person, 6)).turns.any()
    bumped, back = written(person, {2: (0.0, 6.0 * PIXEL, 0.0)})
    told = found(bumped, masks_of(person, 6))
    assert list(np.flatnonzero(told.turns.any(axis=1))) == [2]
    assert np.abs((told.turns - back)[:, :2] * bumped.intrinsics[:, 0, 0][:, None]).max() < PIXEL


@pytest.mark.parametrize(
    "px",
    [
        {2: (0.0, 4.0, 0.0)},
        {2: (3.0, -15.0, 0.0)},
        {0: (0.0, 4.0, 0.0), 1: (0.0, 4.0, 0.0)},
        {1: (0.0, 0.0, 8.0), 4: (0.0, 0.0, -8.0)},
        {1: (-5.0, 0.0, 0.0), 6: (0.0, 3.0, 0.0)},
    ],
    ids=["yaw", "far", "two alike", "two rolled", "two ways"],
)
def test_cameras_that_are_turned_are_turned_back(
    person: PersonCapture, px: dict[int, tuple[float, float, float]]
) -> None:
    """Within a pixel where the subject is: masks of 128 px end at whole pixels, and the hull of eight views is as much
    wider than the subject. A roll moves only what is beside the middle, here by a fifth of its px."""
    rig, back = written(person, px)
    told = found(rig, masks_of(person))
    assert set(np.flatnonzero(told.turns.any(axis=1))) == set(px)
    assert not told.wrong
    off = (told.turns - back) * rig.intrinsics[:, 0, 0][:, None]
    assert np.abs(off[:, :2]).max() < 1.0
    assert np.abs(off[:, 2]).max() < 5.0
    assert (told.apart[list(px)] > 0).all()


def resized(rig: Rig, views: list[int], by: float) -> Rig:
    """The same with pictures of some cameras so many times as large."""
    intrinsics, size = rig.intrinsics.copy(), rig.size.copy()
    intrinsics[views] = np.diag([by, by, 1.0]) @ intrinsics[views]
    size[views] = (size[views] * by).astype(int)
    return replace(rig, intrinsics=intrinsics, size=size)


def test_a_contradiction_is_as_large_whether_small_or_large_pictures_see_it(person: PersonCapture) -> None:
    """In px of the largest pictures; smaller ones lie at the top left of arrays as large."""
    rig, _ = written(person, {2: (0.0, 6.0, 0.0)})
    masks, others = masks_of(person), [0, 1, 3, 4, 5, 6, 7]
    alike = Outlined.of(rig, masks).excess(rig, 2).mean()
    rig, half = resized(rig, others, 0.5), (SIZE // 2, SIZE // 2)
    for v in others:
        masks[v] = np.pad(cv2.resize(masks[v], half, interpolation=cv2.INTER_AREA), (0, SIZE // 2))
    assert Outlined.of(rig, masks).excess(rig, 2).mean() == pytest.approx(alike, rel=0.15)


def test_a_camera_with_larger_pictures_in_which_nobody_is_seen_changes_nothing(person: PersonCapture) -> None:
    rig, _ = written(person, {2: (0.0, 6.0, 0.0)})
    masks = {v: m for v, m in masks_of(person).items() if v % 2 == 0}
    alike, larger = found(rig, masks), found(resized(rig, [1], 4.0), masks)
    assert alike.turns.any()
    np.testing.assert_array_equal(larger.turns, alike.turns)
    np.testing.assert_allclose(larger.apart, 4 * alike.apart)


def test_a_frame_in_which_nobody_is_changes_nothing(person: PersonCapture) -> None:
    """Of somebody who comes late, and of one whom too few views see yet."""
    rig, _ = written(person, {2: (0.0, 6.0, 0.0)})
    masks, alone = masks_of(person), found(rig, masks_of(person))
    assert set(np.flatnonzero(alone.turns.any(axis=1))) == {2}
    for seen in (0, FEWEST - 1):
        empty = {v: m * (v < seen) for v, m in masks.items()}
        for told in (found(rig, masks, empty), found(rig, empty, masks)):
            np.testing.assert_array_equal(told.turns, alone.turns)
            np.testing.assert_array_equal(told.apart, alone.apart)
    assert not found(rig, {v: 0 * m for v, m in masks.items()}).turns.any()


def test_the_order_of_the_cameras_is_indifferent(person: PersonCapture) -> None:
    rig, _ = written(person, {1: (0.0, 6.0, 0.0), 4: (0.0, -6.0, 0.0)})
    order = [3, 1, 4, 0, 7, 6, 2, 5]
    one, other = (
        found(rig, masks_of(person)),
        found(rig.subset(order), {i: masks_of(person)[v] for i, v in enumerate(order)}),
    )
    assert other.turns == pytest.approx(one.turns[order], abs=1.0 / rig.intrinsics[0, 0, 0])


def test_a_camera_whose_pictures_are_anothers_is_wrong_however_it_is_turned(person: PersonCapture) -> None:
    masks = masks_of(person)
    masks[1], masks[3] = masks[3], masks[1]
    told = found(person.rig, masks)
    assert told.wrong == {1, 3}
    assert told.exchanged
    assert not told.turns.any()
    assert (told.apart[[1, 3]] >= APART * PIXEL).all()


@pytest.mark.parametrize("count", [8, 4])
def test_a_camera_whose_pictures_are_mirrored_is_wrong_and_told_so(person: PersonCapture, count: int) -> None:
    """Columns alone, about the middle of the picture, wherever the principal point lies."""
    rig, views = person.rig.subset(range(0, 8, 8 // count)), range(count)
    masks = {v: person.mask[0, 8 // count * v].copy() for v in views}
    rig.intrinsics[1, 0, 2] += 5.0
    masks[1] = np.roll(masks[1], 5, axis=1)[:, ::-1].copy()
    told = found(rig, masks)
    assert (told.wrong, told.mirrored, told.exchanged) == ({1}, True, False)
    masks[1] = masks[1][::-1, ::-1].copy()  # as it was, upside down
    assert not found(rig, masks).mirrored


def test_masks_that_lack_something_or_have_too_much_turn_nobody_and_accuse_nobody(person: PersonCapture) -> None:
    """What a mask lacks contradicts the others and not itself; what it has too much contradicts itself alone."""
    legs, spot, whole, empty = (masks_of(person) for _ in range(4))
    for v in (1, 5):
        legs[v][legs[v].any(axis=1).nonzero()[0][-1] - 20 :] = 0
    spot[2][5:25, 5:25] = 255
    whole[2][:] = 255
    empty[2][:] = 0
    for masks in (legs, spot, whole, empty):
        told = found(person.rig, masks)
        assert not told.turns.any()
        assert not told.wrong


def test_four_cameras_around_tell_and_fewer_do_not(person: PersonCapture) -> None:
    rig, back = written(person, {2: (0.0, 6.0, 0.0)})
    four = found(rig, {v: m for v, m in masks_of(person).items() if v % 2 == 0})
    assert four.turns * rig.intrinsics[0, 0, 0] == pytest.approx(back * rig.intrinsics[0, 0, 0], abs=1.0)
    few = {v: m for v, m in masks_of(person).items() if v < FEWEST - 1}
    for masks in (few, {}):
        assert not found(rig, masks).turns.any()
    assert not standing(rig, []).turns.any()


def test_half_of_the_cameras_are_not_turned_after_the_others(person: PersonCapture) -> None:
    rig, _ = written(person, {v: (0.0, 5.0 * (-1) ** v, 0.0) for v in range(1, 5)})
    told = found(rig, masks_of(person))
    assert int(told.turns.any(axis=1).sum()) <= 2


def test_a_larger_picture_of_the_same_says_the_same(person: PersonCapture) -> None:
    """Bounds are in px of a picture of a fixed size: masks and intrinsics twice as large."""
    rig, _ = written(person, {2: (0.0, 4.0, 0.0)})
    intrinsics = rig.intrinsics.copy()
    intrinsics[:, :2] *= 2
    large = replace(rig, intrinsics=intrinsics, size=2 * rig.size)
    told = found(large, {v: np.kron(m, np.ones((2, 2), np.uint8)) for v, m in masks_of(person).items()})
    once = found(rig, masks_of(person))
    assert told.turns == pytest.approx(once.turns, abs=0.5 / rig.intrinsics[0, 0, 0] * 2)
