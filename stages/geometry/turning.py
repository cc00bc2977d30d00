"""How far a rectified pair lies turned in its pictures: what is said in its axes, and counts in a picture's own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from posegaussian.stages.geometry.pairs import choose_pairs, pair_report
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.storage.model.cameras import Rig

STRAIGHT = np.deg2rad(10.0)
"""Up to here pairs count as straight: of what is said along two axes 3 % is said of the other one."""


def turn_about_axis(rotation: np.ndarray) -> float:
    """Radians about z that are left of a rotation [3, 3] after the smallest one that tilts the z axis where it goes."""
    return float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))


def turn_in_picture(rig: Rig, pair: RectifiedPair, which: int) -> float:
    """Radians by which the axes of a rectified pair are turned in the picture of one of its views, from x towards y."""
    return turn_about_axis(rig.rotations[pair.views[which]] @ pair.rotation.T)


def common_turn(turns: Iterable[float]) -> float:
    """Radians in (-pi/4, pi/4] that some turns have in common but for quarters, for two axes that are turned by a
    quarter are the same two axes. 0 of none."""
    mean = np.exp(4j * np.fromiter(turns, np.float64)).sum()
    return float(np.angle(mean)) / 4 if abs(mean) > 1e-9 else 0.0


def turned_pairs(rig: Rig, views: Sequence[int], count: int, widest: float) -> bool:
    """Whether in the picture of any view its pairs (its `count` nearest, none above `widest` degrees) lie turned, by
    more than `STRAIGHT` and not by quarters."""
    views = tuple(views)
    seeing = rig.subset(views)
    centre, up = look_at_point(seeing), up_direction(seeing)
    found: dict[int, list[float]] = {}
    for a, partners in choose_pairs(rig, views, count, reports=pair_report(rig, views, widest)).items():
        for b in partners:
            pair = rectify(rig, a, b, centre, up=up)
            for which, view in enumerate(pair.views):
                found.setdefault(view, []).append(turn_in_picture(rig, pair, which))
    return any(abs(common_turn(turns)) > STRAIGHT for turns in found.values())
