"""Which views are left out: those whose pictures a run would draw, between others."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.judge.left_out import left_out
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, ring


def arc(*degrees: float, elevation: float = 8.0) -> Rig:
    return rig_of([camera(on_ring(a, elevation), np.zeros(3)) for a in degrees])


@pytest.mark.parametrize("views", [4, 5, 6, 8, 16])
def test_on_a_ring_every_view_stands_between_others(views: int) -> None:
    assert left_out(ring(views), range(views), 64) == list(range(views))


def test_on_an_arc_the_ends_are_not_judged() -> None:
    assert left_out(arc(0, 20, 40, 60), range(4), 8) == [1, 2]
    # In any order of the cameras, and of unequal steps.
    assert left_out(arc(48, 0, 116, 80), range(4), 8) == [0, 3]


def test_a_row_above_another_is_judged_like_it() -> None:
    two_rows = rig_of([camera(on_ring(a, e), np.zeros(3)) for e in (0, 25) for a in (0, 30, 60)])
    assert left_out(two_rows, range(6), 8) == [1, 4]


def test_where_fewer_than_two_views_stand_between_others_all_are_judged() -> None:
    assert left_out(ring(3), range(3), 8) == [0, 1, 2]
    assert left_out(arc(0, 20, 40), range(3), 8) == [0, 1, 2]


def test_only_sources_count_and_few_are_spread_evenly() -> None:
    rig = arc(0, 20, 40, 60, 80, 100)
    assert left_out(rig, [0, 2, 3, 5], 8) == [2, 3]
    assert left_out(ring(8), range(8), 2) == [0, 7]
    assert left_out(arc(*range(0, 90, 10)), range(9), 3) == [1, 4, 7]


def test_how_far_away_a_camera_stands_does_not_matter() -> None:
    rig = rig_of([camera(on_ring(a, radius=r), np.zeros(3)) for a, r in ((0, 2.0), (20, 5.0), (40, 2.0), (60, 3.0))])
    assert left_out(rig, range(4), 8) == [1, 2]
