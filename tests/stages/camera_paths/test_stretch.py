"""Laws of the default path: it stays between neighbours that depth can match, closes where they stand all round, and
follows the cameras wherever the world lies."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.camera_paths.gaps import gap_notes
from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.camera_paths.stretch import best_stretch, stretch_notes
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.pairs import MAX_ANGLE, SHOWN, angle_at, pair_report
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.errors import UserError
from tests.support.known_geometry import camera, on_ring, rig_of, ring

MIDDLE = np.zeros(3)
Place = tuple[float, float, float]
"""Azimuth and elevation in degrees, distance in metres."""


def places(*found: Place) -> Rig:
    return rig_of([camera(on_ring(*p), MIDDLE) for p in found])


def row(*azimuths: float, elevation: float = 8.0, distance: float = 2.0) -> list[Place]:
    return [(a, elevation, distance) for a in azimuths]


RIGS = {
    "two": places((0, 8, 2.0), (50, 20, 2.6)),
    "two groups": places(*row(0, 48, 180, 245)),
    "three of five": places(*row(160, 0, 40, 80, 250)),
    "an arc given out of order": places((90, 5, 2), (0, 30, 2.5), (60, 10, 3), (30, 20, 2)),
    "eight around": ring(8, size=(1024, 1024), focal=819.2),
    "uneven, all around": places(
        (0, 8, 2), (40, 12, 2.3), (100, 5, 2), (150, 20, 2.6), (200, 8, 2), (250, 0, 1.9), (310, 8, 2.2)
    ),
    "two rows, all around": places(*row(*range(0, 360, 40), elevation=0), *row(*range(20, 380, 40), elevation=35)),
    "a camera above": places(*row(0, 40, 80), (0, 89.9, 2)),
}
CLOSED = {"eight around", "uneven, all around", "two rows, all around"}


def path_of(rig: Rig, frames: int = 36, sources: tuple[int, ...] | None = None) -> CameraPath:
    chosen = tuple(range(len(rig))) if sources is None else sources
    return make_path(
        "between",
        rig,
        Views(rig.names, chosen, tuple(v for v in range(len(rig)) if v not in chosen)),
        np.arange(frames),
    )


def centres(path: CameraPath) -> np.ndarray:
    pose = path.world_to_camera[:, 0]
    return -np.einsum("fji,fj->fi", pose[:, :3, :3], pose[:, :3, 3])


def cylinder(rig: Rig, points: np.ndarray) -> np.ndarray:
    """[n, 3] azimuth, height and distance from the axis, as the rig's subject and up make them."""
    subject, up = look_at_point(rig), up_direction(rig)
    side = np.cross(up, [0.3, 0.9, 0.2])
    side /= np.linalg.norm(side)
    offset = points - subject
    height = offset @ up
    return np.stack(
        [
            np.arctan2(offset @ np.cross(up, side), offset @ side),
            height,
            np.linalg.norm(offset - height[:, None] * up, axis=1),
        ],
        axis=1,
    )


@pytest.mark.parametrize("name", RIGS)
def test_every_camera_lies_between_two_neighbours_that_can_be_matched(name: str) -> None:
    """In azimuth, height and distance, so that it is nowhere farther from the two than they are from each other, but
    for the bulge of a parallel (2 degrees)."""
    rig, slack = RIGS[name], 1e-9
    known, subject = cylinder(rig, rig.centres), look_at_point(rig)
    usable = [r for r in pair_report(rig, None, SHOWN) if r.usable]
    for centre, (azimuth, height, distance) in zip(
        centres(path_of(rig)), cylinder(rig, centres(path_of(rig))), strict=True
    ):
        within = False
        for r in usable:
            assert r.angle <= SHOWN
            low, high = np.minimum(*known[list(r.views)]), np.maximum(*known[list(r.views)])
            gap = (known[r.views[1], 0] - known[r.views[0], 0] + np.pi) % (2 * np.pi) - np.pi
            on = ((azimuth - known[r.views[0], 0] + np.pi) % (2 * np.pi) - np.pi) * np.sign(gap)
            near = max(angle_at(subject, centre, rig.centres[v]) for v in r.views) <= r.angle + 2
            within |= bool(
                -slack <= on <= abs(gap) + slack
                and low[1] - slack <= height <= high[1] + slack
                and low[2] - slack <= distance <= high[2] + slack
                and near
            )
        assert within


@pytest.mark.parametrize("name", RIGS)
def test_it_closes_and_moves_in_small_even_steps(name: str) -> None:
    rig, frames = RIGS[name], 72
    path = path_of(rig, frames)
    stretch = best_stretch(rig, range(len(rig)))
    assert stretch is not None
    assert stretch.closed == (name in CLOSED)
    where = centres(path)
    steps = np.linalg.norm(np.diff(np.concatenate([where, where[:1]]), axis=0), axis=1)
    # Even speed around; there and back the middle of a cosine is pi / 2 times as fast as the mean. Twice for heights
    # and distances on the way.
    assert steps.max() <= 2 * np.pi / 2 * steps.mean()
    turned = np.unwrap(cylinder(rig, where)[:, 0])
    if name in CLOSED:
        assert turned[-1] - turned[0] == pytest.approx(2 * np.pi * (1 - 1 / frames))
        assert steps.max() - steps.min() < steps.mean()
    else:
        np.testing.assert_allclose(where[1:], where[:0:-1], atol=1e-9, err_msg="the way back is the way there")
        np.testing.assert_allclose(
            [where[0], where[frames // 2]], rig.centres[[stretch.views[0], stretch.views[-1]]], atol=1e-9
        )


@pytest.mark.parametrize(
    ("name", "views"),
    [
        ("two groups", (0, 1)),
        ("three of five", (1, 2, 3)),
        ("an arc given out of order", (1, 3, 2, 0)),
        ("a camera above", (0, 1, 2)),
    ],
)
def test_the_best_covered_stretch_is_chosen(name: str, views: tuple[int, ...]) -> None:
    stretch = best_stretch(RIGS[name], range(len(RIGS[name])))
    assert stretch is not None
    assert stretch.views == views


def test_a_ring_passes_every_camera_and_two_rows_are_not_zigzagged() -> None:
    around = best_stretch(RIGS["eight around"], range(8))
    rows = best_stretch(RIGS["two rows, all around"], range(18))
    assert around is not None
    assert rows is not None
    assert around.views == tuple(range(8))
    assert rows.views in (tuple(range(9)), tuple(range(9, 18)))


@pytest.mark.parametrize("uneven", [0.0, 4.0])
@pytest.mark.parametrize("rings", [(12, 0.0, 30.0, 60.0), (8, 0.0, 35.0, 70.0), (8, 60.0, 45.0, -5.0)])
def test_in_a_dome_it_goes_around_the_subject_and_not_above_it(rings: tuple[float, ...], uneven: float) -> None:
    """Hops along the steepest ring are the shortest ones, and none of the rings is quite as even as another."""
    count, *elevations = rings
    rng = np.random.default_rng(4)
    steps = 360.0 / count * np.arange(count)
    found = [(a + rng.normal(0, uneven), e, 2.0) for e in elevations for a in steps]
    stretch = best_stretch(places(*found), range(len(found)))
    assert stretch is not None
    assert stretch.closed
    assert len(stretch.views) == count
    assert {found[v][1] for v in stretch.views} == {min(elevations, key=abs)}


def test_near_and_far_neighbours_stand_side_by_side_but_not_one_straight_behind_another() -> None:
    """Rows of the two cannot be made one, but a sweep compares them without; what looks along the other's rays tells
    it nothing, and would be a jump of metres on the spot."""
    mixed = places(*((45.0 * v, 8, (1.5, 6.0)[v % 2]) for v in range(8)))
    found = best_stretch(mixed, range(8))
    assert found is not None
    assert found.closed
    assert found.views == tuple(range(8))
    path = path_of(mixed)
    assert gap_notes(mixed, range(8), MAX_ANGLE, {path.name: path}) == []
    behind = places(*row(*range(0, 360, 45)), (2, 8, 6))
    found = best_stretch(behind, range(9))
    assert found is not None
    assert found.views == tuple(range(8))
    assert best_stretch(behind, (0, 8)) is None


def test_past_cameras_above_each_other_the_path_goes_up_and_down() -> None:
    stack = rig_of([camera(on_ring(0, e), np.zeros(3)) for e in (0, 20, 40)])
    found = best_stretch(stack, range(3))
    assert found is not None
    assert set(found.views) == {0, 1, 2}
    assert found.views[1] == 1
    assert not found.closed
    # The subject, where the cameras look, is 1e-4 of the way off.
    assert found.span == pytest.approx(40, abs=0.1)
    path = path_of(stack)
    np.testing.assert_allclose(centres(path)[:, 1], 0, atol=1e-6)
    heights = centres(path)[:, 2]
    assert np.ptp(heights) > 0.9 * np.ptp(stack.centres[:, 2])
    beside = best_stretch(rig_of([camera(on_ring(a), np.zeros(3)) for a in (0, 20, 40)]), range(3))
    assert beside is not None
    assert beside.span == pytest.approx(found.span, abs=1.0)


@pytest.mark.parametrize("name", ["two groups", "stack"])
def test_the_subject_stays_in_the_middle_upright(name: str) -> None:
    rig = RIGS[name] if name in RIGS else rig_of([camera(on_ring(0, e), np.zeros(3)) for e in (0, 20, 40)])
    path = path_of(rig, 9)
    for pose, k in zip(path.world_to_camera[:, 0], path.intrinsics[:, 0], strict=True):
        seen = pose[:3, :3] @ look_at_point(rig) + pose[:3, 3]
        np.testing.assert_allclose(seen[:2], 0, atol=1e-9)
        assert pose[1, :3] @ up_direction(rig) < 0
        np.testing.assert_allclose(k[:2, 2], path.size[0] / 2)


@pytest.mark.parametrize("name", RIGS)
def test_it_follows_the_cameras_under_a_rigid_motion_and_is_made_alike_twice(name: str) -> None:
    rig = RIGS[name]
    turn = camera(np.array([0.4, -1.0, 0.7]), np.array([3.0, 2.0, 0.1]), 25.0)
    moved = Rig(rig.names, rig.intrinsics, rig.distortion, rig.world_to_camera @ np.linalg.inv(turn), rig.size)
    expected = centres(path_of(rig)) @ turn[:3, :3].T + turn[:3, 3]
    np.testing.assert_allclose(centres(path_of(moved)), expected, atol=1e-9)
    again = Rig(rig.names, rig.intrinsics.copy(), rig.distortion.copy(), rig.world_to_camera.copy(), rig.size.copy())
    assert path_of(again).name == path_of(rig).name


def test_only_sources_are_passed_and_without_a_pair_it_says_so() -> None:
    rig = RIGS["eight around"]
    stretch = best_stretch(rig, (0, 1, 2, 5))
    assert stretch is not None
    assert stretch.views == (0, 1, 2)
    with pytest.raises(UserError, match=r"no two of the source cameras cam0, cam4 can be matched.*render sway"):
        path_of(rig, sources=(0, 4))
    with pytest.raises(UserError, match="no two of the source cameras cam3"):
        path_of(rig, sources=(3,))


def test_a_narrower_bound_opens_the_ring_and_none_closes_one_of_four() -> None:
    """Four cameras are matched, 90 degrees apart, but not shown in between where nobody asks for it."""
    five, four = (rig_of([camera(on_ring(a, 0), MIDDLE) for a in range(0, 360, step)], focal=600) for step in (72, 90))
    wide = best_stretch(five, range(5))
    assert wide is not None
    assert wide.closed
    assert best_stretch(five, range(5), 66) is None
    assert any(r.usable for r in pair_report(four))
    assert best_stretch(four, range(4)) is None


def test_the_plan_says_whom_the_path_does_not_pass() -> None:
    rig = RIGS["two groups"]
    path = path_of(rig)
    (note,) = stretch_notes(rig, range(4), MAX_ANGLE, {path.name: path})
    assert path.name in note
    assert "cam0 - cam1" in note
    assert "does not pass cam2, cam3" in note
    assert stretch_notes(rig, range(4), MAX_ANGLE, {}) == []
    ring_path = path_of(RIGS["eight around"])
    assert stretch_notes(RIGS["eight around"], range(8), MAX_ANGLE, {ring_path.name: ring_path}) == []
