"""Which views make a picture: nearest valid ones, with weights that leave no jump."""

import numpy as np
import pytest

from posegaussian.stages.rendering.sources import angles_at, choose

RING = np.array([[np.cos(a), np.sin(a), 0.3] for a in np.arange(8) * np.pi / 4])


def at(degrees: float) -> np.ndarray:
    return np.array([2 * np.cos(np.radians(degrees)), 2 * np.sin(np.radians(degrees)), 0.5])


def weights(degrees: float, usable: np.ndarray | None = None, count: int = 2) -> np.ndarray:
    chosen = choose(
        angles_at(np.array([0, 0, 0.2]), RING, at(degrees)), np.ones(8, bool) if usable is None else usable, count
    )
    out = np.zeros(8)
    for view, weight in chosen:
        out[view] = weight
    return out


def test_the_neighbours_of_a_middle_view_count_alike() -> None:
    np.testing.assert_allclose(weights(22.5), [1, 1, 0, 0, 0, 0, 0, 0], atol=1e-7)


def test_at_a_source_that_source_stands_alone() -> None:
    np.testing.assert_allclose(weights(45), [0, 1, 0, 0, 0, 0, 0, 0], atol=1e-6)


def test_weights_change_without_a_jump_around_the_ring() -> None:
    for count in (1, 2, 3):
        w = np.array([weights(d, count=count) for d in np.arange(40, 95, 0.05)])
        # the square root is steep where a view fades in: 0.05 degrees of 45 are sqrt(2 * 0.05 / 45) = 0.047
        assert np.abs(np.diff(w, axis=0)).max() < (0.07 if count > 1 else 1.01)
        assert ((w > 0).sum(axis=1) <= count).all()
        np.testing.assert_allclose(w.max(axis=1), 1)


UNEVEN = np.array([[np.cos(a), np.sin(a), 0.2] for a in np.radians([0.0, 48.0, 170.0, 250.0])])
"""Cameras of a sparse rig around the origin, no two gaps alike."""


def uneven(degrees: float, count: int = 2) -> np.ndarray:
    camera = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.2])
    out = np.zeros(len(UNEVEN))
    for view, weight in choose(angles_at(np.zeros(3), UNEVEN, camera), np.ones(len(UNEVEN), bool), count):
        out[view] = weight
    return out


@pytest.mark.parametrize("count", [2, 3])
def test_at_a_source_of_a_sparse_rig_that_source_stands_alone_too(count: int) -> None:
    """Whatever a neighbour far away shows of the same place: it errs there, the source does not."""
    for view, degrees in enumerate((0.0, 48.0, 170.0, 250.0)):
        expected = np.zeros(4)
        expected[view] = 1
        np.testing.assert_allclose(uneven(degrees, count), expected, atol=1e-6)


def test_between_two_of_a_sparse_rig_both_count_alike_midway_and_nothing_jumps() -> None:
    np.testing.assert_allclose(uneven(24.0)[:2], [1, 1], atol=1e-7)
    w = np.array([uneven(d) for d in np.arange(0.0, 48.0, 0.05)])
    assert np.abs(np.diff(w, axis=0)).max() < 0.07  # as around the even ring: the root is steep where a view fades in
    assert (np.diff(w[: len(w) // 2, 1]) >= 0).all(), "the second grows all the way"


def test_views_without_a_picture_are_passed_over() -> None:
    usable = np.ones(8, bool)
    usable[0] = False
    w = weights(22.5, usable)
    assert w[0] == 0
    assert w[1] == 1
    assert w[2] + w[7] > 0


@pytest.mark.parametrize("number", [0, 1, 2])
def test_fewer_views_than_asked_for(number: int) -> None:
    usable = np.arange(8) < number
    assert len(choose(angles_at(np.zeros(3), RING, at(200)), usable, 3)) == number


def test_degenerate_angles_give_finite_weights() -> None:
    assert choose(np.zeros(4), np.ones(4, bool), 2) == [(0, 1.0), (1, 1.0)]
    assert choose(np.array([np.pi]), np.ones(1, bool), 2) == [(0, 1.0)]
    np.testing.assert_allclose(
        angles_at(np.zeros(3), np.array([[1.0, 0, 0], [0, 0, 0]]), np.array([-2.0, 0, 0])), [np.pi, 0]
    )
