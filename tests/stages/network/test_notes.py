"""What is said of views of which the network says nothing: the true cause."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.network.notes import SURE, notes
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, ring

ORIGIN = np.zeros(3)


def in_turn(near: float, far: float) -> Rig:
    """Eight cameras 45 degrees apart, every second one farther away."""
    distances = [near, far] * 4
    poses = [camera(on_ring(45 * k, 0, r), ORIGIN) for k, r in enumerate(distances)]
    return rig_of(poses, focal=[400.0 * r for r in distances])


def said(rig: Rig, view: int = 0, confidence: float = 0.0, left_out: int = 0) -> tuple[str, ...]:
    return notes(rig, range(len(rig)), view, 62.0, confidence, left_out)


def test_a_view_whose_neighbours_stand_behind_it_has_no_pair_and_not_no_confidence() -> None:
    (told,) = said(in_turn(1.5, 6.0))
    assert "no pair of this view" in told
    assert "one behind the other, the baseline lies" in told
    assert "confidence" not in told


def test_a_view_without_a_neighbour_near_enough_has_no_pair() -> None:
    (told,) = said(ring(4))
    assert "no other camera stands within 62 degrees of it" in told


def test_of_a_view_that_has_a_pair_the_confidence_is_told_where_it_is_hardly_any() -> None:
    (told,) = said(ring(8), confidence=0.5 * SURE)
    assert "mean confidence is 0.05" in told
    assert said(ring(8), confidence=SURE) == ()
    (alone,) = notes(ring(8), (3,), 3, 62.0, 0.0, 0)
    assert "mean confidence" in alone


def test_a_pair_with_a_close_up_is_too_large_for_no_fault_of_the_masks() -> None:
    head = np.array([0.0, 0, 0.75])
    around = [camera(on_ring(45 * k), ORIGIN) for k in range(8)]
    rig = rig_of([*around, camera(on_ring(20, 20, 1.5), head)], focal=[819.2] * 8 + [4000.0])
    for view in (0, 8):
        (told,) = said(rig, view, 1.0, left_out=2)
        assert told.startswith("2 of its pairs in these frames were not shown to the network")
        assert "shows a part of the person only" in told
        assert "rim" not in told
    (told,) = said(rig, 4, 1.0, left_out=2)
    assert "parts of the masks at the rim" in told
