"""Gains from surface points that cameras share: what is proven, what is an error of the measure."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.imaging.color import gain_table, to_display, to_linear
from posegaussian.stages.imaging.exposure import FEWEST_POINTS, FLOOR, NONE, match


def points(pairs: dict[tuple[int, int], np.ndarray], cameras: int) -> np.ndarray:
    """[S, S, 64, 3] as the survey notes it, of [n, 3] stops in the order of tone."""
    out = np.full((cameras, cameras, 64, 3), NONE, np.float32)
    for pair, stops in pairs.items():
        out[pair][: len(stops)] = stops
    return out


def ring_of(stops: np.ndarray, spread: float = 0.1, count: int = 40) -> np.ndarray:
    """Cameras whose neighbours share points that scatter by `spread` stops."""
    rng, n = np.random.default_rng(3), len(stops)
    return points({(a, a + 1): stops[a] - stops[a + 1] + spread * rng.normal(size=(count, 3)) for a in range(n - 1)}, n)


def test_a_camera_that_differs_by_less_than_an_error_keeps_its_light() -> None:
    stops = np.zeros((4, 3))
    stops[3], stops[1] = 1.0, 0.02
    found = match(ring_of(stops, 0.01))
    assert found is not None
    assert (found.gains[[0, 1, 2]] == 1).all()
    np.testing.assert_allclose(np.log2(found.gains[3]), -1.0, atol=0.03)


def test_gains_of_single_channels_are_undone() -> None:
    stops = np.zeros((5, 3))
    stops[1], stops[4, 2] = 0.7, -1.0
    found = match(ring_of(stops))
    assert found is not None
    # Medians of 40 points that scatter by a tenth of a stop: 0.02 a pair, up to four pairs on the way.
    np.testing.assert_allclose(np.log2(found.gains), -stops, atol=0.08)
    # Two errors of a chain's end, two pairs from the middle camera, are some 0.3 stops: thirds of 13 points scatter,
    # and each pair has its floor.
    assert 0.45 < found.proven[1] < 0.7
    assert 0.6 < found.proven[4] < 1.0
    assert found.proven[[0, 2, 3]].max() == 0


def test_many_points_that_agree_prove_no_more_than_a_pair_can() -> None:
    found = match(points({(0, 1): np.full((64, 3), 1.0)}, 2))
    assert found is not None
    # Each of two cameras is half of the difference off the middle, and so is the error.
    np.testing.assert_allclose(found.proven, 0.5 - FLOOR, atol=1e-6)
    np.testing.assert_allclose(found.apart, 1.0 - np.eye(2), atol=1e-6)
    np.testing.assert_allclose(found.certain, (1.0 - 2 * FLOOR) * (1.0 - np.eye(2)), atol=1e-6)


def test_cameras_are_as_far_apart_as_their_offsets_whichever_is_in_the_middle() -> None:
    """Half of the cameras half a stop darker: each lies a quarter off the middle, and half a stop off every other."""
    stops = np.zeros((6, 3))
    stops[::2] = -0.5
    found = match(ring_of(stops, 0.01))
    assert found is not None
    np.testing.assert_allclose(found.stops, 0.25, atol=0.03)
    # Medians of 40 points that scatter by a hundredth of a stop.
    np.testing.assert_allclose(found.apart, np.abs(stops[:, None, 0] - stops[None, :, 0]), atol=0.03)
    np.testing.assert_array_equal(found.certain, found.certain.T)
    assert (found.certain <= found.apart).all()
    # The longer the chain of pairs from one to the other, the less is certain.
    assert (found.certain[[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]] > 0.25).all()


def test_cameras_that_nothing_links_are_not_apart() -> None:
    found = match(points({(0, 1): np.full((40, 3), -1.0), (2, 3): np.full((40, 3), 1.0)}, 5))
    assert found is not None
    assert found.apart[:2, 2:].max() == found.certain[:2, 2:].max() == found.apart[4].max() == 0


def test_what_is_brighter_at_some_tones_only_is_no_exposure() -> None:
    """Haze on dark points, or gloss on bright ones: a stop at one end, nothing at the other."""
    for stops in (np.linspace(1.1, 0.0, 60), np.linspace(0.0, 1.1, 60)):
        found = match(points({(0, 1): np.repeat(stops[:, None], 3, 1), (1, 2): np.zeros((60, 3))}, 3))
        assert found is not None
        assert found.proven.max() == 0


def test_pairs_that_contradict_each_other_prove_nothing() -> None:
    same = {(0, 1): np.full((40, 3), 0.6), (1, 2): np.full((40, 3), 0.6), (0, 2): np.full((40, 3), -0.3)}
    found = match(points(same, 3))
    assert found is not None
    assert found.proven.max() == 0


def test_groups_that_see_different_sides_are_brought_together_each_by_itself() -> None:
    found = match(points({(0, 1): np.full((40, 3), -1.0), (2, 3): np.full((40, 3), 1.0)}, 5))
    assert found is not None
    np.testing.assert_allclose(np.log2(found.gains), np.outer([0.5, -0.5, -0.5, 0.5, 0.0], np.ones(3)), atol=1e-6)
    assert match(points({(0, 1): np.full((FEWEST_POINTS - 1, 3), 1.0)}, 2)) is None
    assert match(points({}, 1)) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_difference_within_its_error_is_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = match(points({(0, 1): rng.normal(0, 1.5, (30, 3))}, 2))  # as good as no common surface
    assert found is not None
    assert found.proven.max() < 0.25
    assert (found.gains[found.stops == 0] == 1).all()


def test_the_gain_of_one_changes_no_value_and_tables_are_monotone() -> None:
    np.testing.assert_array_equal(gain_table(np.ones(3))[0], np.arange(256)[:, None].repeat(3, 1))
    for gain in (0.3, 3.0):
        table = gain_table(np.full(3, gain))[0].astype(int)
        assert (np.diff(table, axis=0) >= 0).all()
        # Float32 against float64: a value on the edge may round the other way.
        np.testing.assert_allclose(
            table[:, 0],
            to_display(np.clip(to_linear(np.arange(256)) * gain, 0, 1)[:, None].repeat(3, 1)[None])[0, :, 0],
            atol=1,
        )
