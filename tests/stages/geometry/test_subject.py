"""What is up for a rig, from how its cameras stand and are held."""

from collections.abc import Sequence

import numpy as np
import pytest

from posegaussian.stages.geometry.subject import up_direction
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of

Z = np.array([0.0, 0, 1])
RING, ARC = tuple(range(0, 360, 45)), (-60, -30, 0, 30, 60)


def around(azimuths: tuple[int, ...], rolls: list[float] | float) -> Rig:
    turns = rolls if isinstance(rolls, list) else [rolls] * len(azimuths)
    return rig_of([camera(on_ring(a, 10), np.zeros(3), r) for a, r in zip(azimuths, turns, strict=True)])


def off(rig: Rig) -> float:
    """Degrees between the rig's up and the world's."""
    return float(np.degrees(np.arccos(np.clip(up_direction(rig) @ Z, -1, 1))))


@pytest.mark.parametrize("roll", [0, 20, 45, 70, 90, -90, -45])
def test_a_ring_has_the_same_up_however_it_is_rolled(roll: float) -> None:
    assert off(around(RING, roll)) < 1e-5


@pytest.mark.parametrize("roll", [0, 45, 90, -90])
def test_an_arc_whose_pictures_lie_on_their_side_is_told_from_cameras_above_each_other(roll: float) -> None:
    # The upward axes of cameras that look 10 degrees down lean forward, by 10 degrees at most.
    assert off(around(ARC, roll)) < 10
    stacked = rig_of([camera(on_ring(0, e), np.zeros(3)) for e in (-10, 10, 35)])
    assert off(stacked) < 15


def test_cameras_rolled_each_in_its_own_way_agree_on_what_they_look_along() -> None:
    assert off(around(RING, [0.0, 130, 250, 80, 310, 200, 40, 160])) < 1e-5
    assert off(around(ARC, [0.0, 120, 240, 60, 170])) < 15


def test_pictures_are_believed_where_all_can_be_upright() -> None:
    assert off(around(RING, 180)) == pytest.approx(180)
    pair = around((0, 20), 90)
    np.testing.assert_allclose(up_direction(pair), -pair.rotations[:, 1].mean(axis=0), atol=0.02)


def placed(*places: tuple[float, float], rolls: np.ndarray | float = 0.0) -> Rig:
    """Cameras at (azimuth, elevation) that look at the origin."""
    turns = np.broadcast_to(rolls, len(places))
    return rig_of([camera(on_ring(*p), np.zeros(3), r) for p, r in zip(places, turns, strict=True)])


def standing(azimuths: Sequence[float], heights: Sequence[float], rolls: Sequence[float]) -> Rig:
    """Cameras 3 m from a standing person whose middle, 0.92 m above the ground, they look at."""
    person = np.array([0.0, 0, 0.92])
    places = zip(azimuths, np.resize(heights, len(azimuths)), np.resize(rolls, len(azimuths)), strict=True)
    return rig_of([camera(np.append(on_ring(a, 0.0, 3.0)[:2], h), person, r) for a, h, r in places])


RIGS = [
    *((tuple(np.arange(n) * 360.0 / n), (h,)) for n in (3, 4, 6, 8, 16) for h in (0.7, 1.2, 1.8)),
    *((tuple(np.linspace(-w, w, n)), (h,)) for n, w in ((3, 40), (4, 45), (5, 50), (6, 75)) for h in (1.2, 1.8)),
    *((tuple(np.linspace(-w, w, n)), (1.0, 2.2)) for n, w in ((3, 40), (4, 45), (5, 50), (6, 75))),
]


@pytest.mark.parametrize(("azimuths", "heights"), RIGS)
def test_any_one_camera_may_be_mounted_sideways_or_on_its_head(
    azimuths: tuple[float, ...], heights: tuple[float, ...]
) -> None:
    # By the mean of the upward axes 8 degrees of a ring of 8, 49 of one of 4, 105 of an arc of 3.
    upright = up_direction(standing(azimuths, heights, (0.0,)))
    for view in range(len(azimuths)):
        for quarter in (90.0, -90.0, 180.0):
            rolls = np.zeros(len(azimuths))
            rolls[view] = quarter
            np.testing.assert_allclose(up_direction(standing(azimuths, heights, rolls)), upright, atol=1e-9)


@pytest.mark.parametrize("rolls", [(0.0, 90.0), (0.0, -90.0), (0.0, 180.0), (90.0, -90.0), (90.0, 90.0, 0.0, -90.0)])
@pytest.mark.parametrize(("azimuths", "heights"), [r for r in RIGS if len(r[0]) % 2 == 0 and r[1] != (0.7,)])
def test_pictures_may_alternate_between_landscape_and_portrait(
    azimuths: tuple[float, ...], heights: tuple[float, ...], rolls: tuple[float, ...]
) -> None:
    upright = up_direction(standing(azimuths, heights, (0.0,)))
    np.testing.assert_allclose(up_direction(standing(azimuths, heights, rolls)), upright, atol=1e-9)


def test_quarters_are_told_from_rolls_by_hand() -> None:
    rng, worst = np.random.default_rng(7), 0.0
    for azimuths in (RING, ARC, (0, 90, 180, 270)):
        for _ in range(30):
            rolls = rng.normal(0, 4, len(azimuths))
            turned = rolls + 90.0 * (np.arange(len(azimuths)) == rng.integers(len(azimuths)))
            as_mounted, upright = (up_direction(standing(azimuths, (1.3,), r)) for r in (turned, rolls))
            worst = max(worst, float(np.degrees(np.arccos(np.clip(as_mounted @ upright, -1, 1)))))
    assert worst < 1e-4


@pytest.mark.parametrize("roll", [0.0, 90.0, -90.0])
@pytest.mark.parametrize(("azimuths", "heights"), [r for r in RIGS if r[1] != (0.7,)])
def test_cameras_that_look_down_from_one_side_lean_nothing_over(
    azimuths: tuple[float, ...], heights: tuple[float, ...], roll: float
) -> None:
    # The mean of the upward axes leans over by the cameras' pitch: by 14 degrees of an arc of four 1.8 m high. Three
    # optical axes always end in a plane: read as a cone's, that of 1, 2.2 and 1 m turned up over. Where heights rise
    # along an arc, pictures on their side agree best upon something that is rolled, too.
    rising = roll != 0 and len(azimuths) % 2 == 0 and heights == (1.0, 2.2)
    assert off(standing(azimuths, heights, (roll,))) < (10 if rising else 5)


@pytest.mark.parametrize("roll", [75.0, 90.0, 100.0, -80.0, -90.0])
def test_pictures_on_their_side_are_not_asked_which_way_is_up(roll: float) -> None:
    for azimuths in ((-40.0, 0.0, 40.0), (-50.0, -25.0, 0.0, 25.0, 50.0)):
        for heights in ((1.2,), (1.8,), (1.0, 2.2)):
            assert off(standing(azimuths, heights, (roll,))) < 5


def test_a_pair_that_looks_down_leans_over_by_a_third_of_that() -> None:
    assert off(standing((-15.0, 15.0), (1.8,), (0.0,))) < 5.5


@pytest.mark.parametrize("elevation", [25.0, 40.0, 50.0])
@pytest.mark.parametrize("azimuths", [(0.0, 180.0), (0.0, 90.0), (-50.0, 0.0, 50.0)])
def test_cameras_that_stand_upright_are_turned_by_nothing_from_above(
    azimuths: tuple[float, ...], elevation: float
) -> None:
    # Turned by quarters, each its own way, they agree better upon a direction that lies level.
    for rolls in ((0.0, 0.0, 0.0), (3.0, -4.0, 2.0)):
        assert off(placed(*((a, elevation) for a in azimuths), rolls=np.array(rolls[: len(azimuths)]))) < 12


def test_a_roll_in_common_is_no_quarter() -> None:
    assert off(placed((0, 5), (120, 5), (240, 5), (20, 60), (100, 50), rolls=45.0)) < 1.5
    for roll in (30.0, 45.0):
        assert off(placed((0, 10), (180, 10), rolls=roll)) < 1e-5
        assert off(placed((0, 25), (100, 25), rolls=roll)) < 2


def test_lower_edges_that_contradict_each_other_right_nothing() -> None:
    # Rolled by hand, between 13 degrees one way and 23 the other, the mean of the upward axes is nearer.
    rig = standing((0.0, 50.0, 150.0, 215.0), (2.2,), (14.6, -2.3, -1.9, -25.4))
    mean = -rig.rotations[:, 1].mean(axis=0)
    np.testing.assert_array_equal(up_direction(rig), mean / np.linalg.norm(mean))


ABOVE, BELOW = (0.0, 89.9), (70.0, -89.9)


@pytest.mark.parametrize("roll", [0.0, 90.0])
@pytest.mark.parametrize("steep", [(ABOVE,), (ABOVE, (140.0, 85.0)), (ABOVE, BELOW), ((20.0, 60.0), (100.0, 50.0))])
@pytest.mark.parametrize("around", [3, 6, 20])
def test_cameras_that_look_steeply_down_or_up_tilt_nothing(
    around: int, steep: tuple[tuple[float, float], ...], roll: float
) -> None:
    # Up to 18 degrees by the mean of the upward axes, to which a camera straight above adds a horizontal one.
    level = [(360.0 * i / around, 5.0) for i in range(around)]
    assert off(placed(*level, *steep, rolls=roll)) < 1.5


def test_a_half_of_a_dome_and_an_arc_from_above_are_upright() -> None:
    half = [(a, e) for e, most in ((0.0, 75), (35.0, 60), (65.0, 45)) for a in np.linspace(-most, most, 5)]
    assert off(placed(*half)) < 2.5
    for height in (45.0, 60.0):
        assert off(placed(*((a, height) for a in ARC))) < 3


def test_rolled_cameras_say_up_as_well_with_a_camera_above_them_as_without() -> None:
    rng, level = np.random.default_rng(5), [(45.0 * i, 5.0) for i in range(8)]
    rolls = rng.normal(0, 3, (100, 9))
    alone, above = (
        [off(placed(*places, rolls=r[: len(places)])) for r in rolls] for places in (level, [*level, ABOVE])
    )
    assert np.mean(above) < np.mean(alone) + 0.2


@pytest.mark.parametrize("elevation", [0, 15, 30])
def test_where_nobody_looks_steeply_up_is_what_pictures_say_to_the_last_digit(elevation: float) -> None:
    rig = placed(*((45.0 * i, elevation) for i in range(8)), rolls=np.random.default_rng(2).normal(0, 3, 8))
    mean = -rig.rotations[:, 1].mean(axis=0)
    np.testing.assert_array_equal(up_direction(rig), mean / np.linalg.norm(mean))


def test_up_turns_with_the_world_and_not_with_the_order() -> None:
    mounted = around(ARC, [3.0, -5, 92, 8, -4]), around(ARC, [3.0, 175, 2, 98, -86])
    for rig in (*mounted, around(ARC, [3.0, -5, 2, 8, -4]), placed((0, 5), (50, 12), ABOVE, (130, 40), (200, 3))):
        turns_with_the_world(rig)


def turns_with_the_world(rig: Rig) -> None:
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    poses = rig.world_to_camera.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ turn.T
    moved = rig_of(list(poses))
    np.testing.assert_allclose(up_direction(moved), turn @ up_direction(rig), atol=1e-9)
    np.testing.assert_allclose(up_direction(rig.subset([3, 1, 0, 4, 2])), up_direction(rig), atol=1e-12)
