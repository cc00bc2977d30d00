"""Sources asked for by number: evenly around a ring, from end to end of an arc, at the middle height."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.roles import evenly, sources_of


def rig(degrees: list[float], above: list[float] | None = None, tilt: float = 0.0) -> Rig:
    """Cameras c0, c1, ... 3 m from (1, 2, 3), all looking at it; the ring may be tilted."""
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    poses = []
    for a, e in zip(np.radians(degrees), np.radians(above or [0.0] * len(degrees)), strict=True):
        away = turn @ [np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)]
        right = np.cross(turn @ [0, 0, -1], -away)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(-away, right), -away])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ (np.array([1, 2, 3]) + 3 * away)
        poses.append(pose)
    count = len(degrees)
    k = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    names = tuple(f"c{i}" for i in range(count))
    return Rig(names, np.tile(k, (count, 1, 1)), np.zeros((count, 8)), np.stack(poses), np.full((count, 2), 640))


def chosen(made: Rig, count: int) -> list[int]:
    return [int(n[1:]) for n in evenly(made, count)]


@pytest.mark.parametrize("tilt", [0.0, 0.7, 1.57])
@pytest.mark.parametrize("height", [0.0, 25.0, 60.0])
def test_a_ring_is_divided_evenly(tilt: float, height: float) -> None:
    made = rig([30.0 * i + 7 for i in range(12)], [height] * 12, tilt)
    assert chosen(made, 4) == [0, 3, 6, 9]
    assert chosen(made, 6) == [0, 2, 4, 6, 8, 10]
    assert chosen(made, 12) == list(range(12))
    gaps = np.diff([*chosen(made, 8), chosen(made, 8)[0] + 12])
    assert sorted({*gaps.tolist()}) == [1, 2]


def test_names_in_another_order_than_the_ring_change_nothing() -> None:
    order = np.random.default_rng(1).permutation(12)
    picked = [order[i] for i in chosen(rig([30.0 * i for i in order]), 4)]
    assert sorted((np.array(picked) - picked[0]) % 12) == [0, 3, 6, 9]


def test_an_arc_is_taken_from_end_to_end() -> None:
    assert chosen(rig([350 + 15.0 * i for i in range(7)]), 3) == [0, 3, 6]
    assert chosen(rig([350 + 15.0 * i for i in range(7)]), 2) == [0, 6]
    assert chosen(rig([0.0, 20.0]), 2) == [0, 1]
    assert len(chosen(rig([0.0, 20.0]), 1)) == 1
    assert chosen(rig([12.0]), 1) == [0]


def test_of_cameras_above_each_other_the_middle_ones_are_taken() -> None:
    degrees = [45.0 * i for i in range(8)]
    made = rig(degrees * 3, [-30.0] * 8 + [0.0] * 8 + [30.0] * 8)
    assert chosen(made, 4) == [8, 10, 12, 14]


def test_sources_by_number_by_name_and_by_default() -> None:
    made = rig([30.0 * i for i in range(12)])
    assert sources_of(None, made, ["c3"]) == [f"c{i}" for i in range(12) if i != 3]
    assert sources_of(["c5", "c1"], made, []) == ["c5", "c1"]
    assert sources_of("uniform 4", made, ["c0"]) == ["c1", "c4", "c7", "c10"]
    with pytest.raises(
        ConfigError, match=r"views.sources: uniform 12 asks for 12 cameras, and 11 are not held out; ask"
    ):
        sources_of("uniform 12", made, ["c0"])
