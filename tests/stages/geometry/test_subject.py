"""What is up for a rig, from how its cameras stand and are held."""

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
    for rig in (around(ARC, [3.0, -5, 2, 8, -4]), placed((0, 5), (50, 12), ABOVE, (130, 40), (200, 3))):
        turns_with_the_world(rig)


def turns_with_the_world(rig: Rig) -> None:
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    poses = rig.world_to_camera.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ turn.T
    moved = rig_of(list(poses))
    np.testing.assert_allclose(up_direction(moved), turn @ up_direction(rig), atol=1e-9)
    np.testing.assert_allclose(up_direction(rig.subset([3, 1, 0, 4, 2])), up_direction(rig), atol=1e-12)
