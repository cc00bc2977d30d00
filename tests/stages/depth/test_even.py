import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.smooth_disparity import JUMP, RADIUS, even

PIXEL = 0.002
"""1/metres a px of disparity."""


def surface(disparity: np.ndarray) -> np.ndarray:
    return (1 / (0.4 + PIXEL * disparity)).astype(np.float32)


def disparity(depth: np.ndarray) -> np.ndarray:
    return (1 / depth.astype(np.float64) - 0.4) / PIXEL


ROWS, COLUMNS = np.mgrid[:30, :40].astype(np.float64)


def test_a_slanted_plane_stays_as_it_is() -> None:
    plane = surface(0.7 * COLUMNS - 0.4 * ROWS + 20)
    # float32 keeps 7 digits of the inverse depth.
    assert even(plane, PIXEL, 1.0) == pytest.approx(plane, rel=2e-6)


def test_noise_shrinks_and_an_edge_stands() -> None:
    noise = np.random.default_rng(4).normal(0, 0.2, ROWS.shape)
    step = np.where(COLUMNS >= 20, 30.0 + JUMP, 20.0)
    found = disparity(even(surface(step + noise), PIXEL, 1.0)) - step
    assert found.std() < 0.5 * noise.std()
    # A bridged edge would move the pixels beside it by a good part of 18 px.
    assert np.abs(found).max() < 1


def test_nothing_appears_and_nothing_vanishes() -> None:
    depth = surface(0 * ROWS)
    depth[10:14] = 0
    found = even(depth, PIXEL, 0.5)
    assert ((found > 0) == (depth > 0)).all()
    assert even(np.zeros((5, 5), np.float32), PIXEL, 0.5).max() == 0


def test_without_a_neighbour_there_is_no_scale_and_nothing_changes() -> None:
    depth = surface(np.random.default_rng(5).normal(0, 1, ROWS.shape))
    assert np.array_equal(even(depth, 0.0, 1.0), depth)


def test_a_pixel_is_moved_by_its_neighbourhood_alone() -> None:
    disparities = np.random.default_rng(6).normal(0, 0.3, ROWS.shape)
    changed = disparities.copy()
    changed[15, 20] += 0.5
    moved = np.argwhere(even(surface(disparities), PIXEL, 1.0) != even(surface(changed), PIXEL, 1.0))
    assert len(moved) > 1
    assert np.abs(moved - [15, 20]).max() <= RADIUS
