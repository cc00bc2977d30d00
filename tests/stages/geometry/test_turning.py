"""Turns of rectified pairs in their pictures: a rolled picture is turned by its roll, and quarters change no axes."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.geometry.turning import STRAIGHT, common_turn, turn_about_axis, turn_in_picture, turned_pairs
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of

ANGLES = (-20.0, 0.0, 20.0, 40.0)


def about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def about_x(angle: float) -> np.ndarray:
    return about_z(angle)[np.ix_([2, 0, 1], [2, 0, 1])]


def ring(rolls: float | tuple[float, ...] = 0.0) -> Rig:
    """Cameras side by side, each picture rolled by radians from x towards y."""
    poses = [camera(on_ring(a), np.zeros(3)) for a in ANGLES]
    for pose, roll in zip(poses, np.broadcast_to(rolls, len(poses)), strict=True):
        pose[:3] = about_z(roll) @ pose[:3]
    return rig_of(poses, (96, 96), focal=170.0)


@pytest.mark.parametrize("angle", [0.0, 0.5, -2.0, 3.0])
def test_a_tilt_of_the_axis_adds_no_turn(angle: float) -> None:
    assert turn_about_axis(about_z(angle)) == pytest.approx(angle)
    tilted = about_z(0.7) @ about_x(0.4) @ about_z(-0.7)
    assert turn_about_axis(tilted @ about_z(angle)) == pytest.approx(angle)


@pytest.mark.parametrize("roll", [0.4, -0.9, np.pi / 2])
def test_a_rolled_picture_shows_its_pair_turned_by_the_roll(roll: float) -> None:
    level, rolled = ring(), ring(roll)
    pair = rectify(level, 0, 1, np.zeros(3))
    assert abs(turn_in_picture(level, pair, 0)) < 0.1
    for which in (0, 1):
        apart = turn_in_picture(rolled, pair, which) - turn_in_picture(level, pair, which)
        assert apart == pytest.approx(roll)


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.7])
def test_quarters_do_not_count(turn: float) -> None:
    assert common_turn([turn + q * np.pi / 2 for q in (-2, 0, 1, 3)]) == pytest.approx(turn)
    assert common_turn([turn - 0.02, turn + 0.02]) == pytest.approx(turn)
    assert common_turn([]) == 0


def test_pairs_are_turned_where_some_picture_is_rolled_and_not_by_quarters() -> None:
    assert not turned_pairs(ring(), range(4), 2, 62.0)
    assert not turned_pairs(ring(np.pi / 2), range(4), 2, 62.0)
    assert not turned_pairs(ring((0, np.pi / 2, np.pi, 0)), range(4), 2, 62.0)
    assert not turned_pairs(ring(STRAIGHT / 2), range(4), 2, 62.0)
    assert turned_pairs(ring((0, 0, 0.5, 0)), range(4), 2, 62.0)
    assert turned_pairs(ring(np.pi / 4), range(4), 2, 62.0)
