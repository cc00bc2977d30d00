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


def test_up_turns_with_the_world_and_not_with_the_order() -> None:
    rig = around(ARC, [3.0, -5, 2, 8, -4])
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    poses = rig.world_to_camera.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ turn.T
    moved = rig_of(list(poses))
    np.testing.assert_allclose(up_direction(moved), turn @ up_direction(rig), atol=1e-9)
    np.testing.assert_allclose(up_direction(rig.subset([3, 1, 0, 4, 2])), up_direction(rig), atol=1e-12)
