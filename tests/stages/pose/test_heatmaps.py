"""Laws of the joint-to-heatmap encoding (hard cases P1 no person, P2 joint at the border, P3 sigma to 0)."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.pose.heatmaps import FLOOR, draw, grid_of

SIZE, GRID = (64, 48), (12, 16)


def one(
    u: float,
    v: float,
    score: float = 1.0,
    sigma: float = 6.0,
    size: tuple[int, int] = SIZE,
    grid: tuple[int, int] = GRID,
) -> np.ndarray:
    return draw(np.array([[[u, v, score]]]), np.array([[sigma]]), size, grid)[0, 0]


def test_the_value_is_the_gaussian_at_the_cell_centre() -> None:
    u, v, score, sigma = 30.7, 21.2, 0.8, 6.0
    rows, columns = np.mgrid[:12, :16]
    expected = score * np.exp(-((4 * columns + 2 - u) ** 2 + (4 * rows + 2 - v) ** 2) / (2 * sigma**2))
    expected[expected < FLOOR] = 0
    found = one(u, v, score, sigma)
    assert found.dtype == np.float16
    assert found.shape == GRID
    np.testing.assert_allclose(found, expected, atol=5e-4)  # half a unit of float16 at 1
    assert (found[found > 0] >= FLOOR).all()


def test_a_joint_on_a_cell_centre_peaks_at_its_score() -> None:
    for score in (0.25, 0.5, 1.0):  # exact in float16
        found = one(4 * 7 + 2, 4 * 5 + 2, score)
        assert found[5, 7] == found.max() == score


def test_moving_by_a_cell_moves_the_map_by_a_cell() -> None:
    np.testing.assert_array_equal(one(26.5, 22.5)[2:, 2:], one(26.5 - 4, 22.5 - 8)[:-2, 1:-1])


def test_no_person_no_mass() -> None:
    assert not one(30, 20, score=0.0).any()
    assert not draw(np.zeros((2, 17, 3)), np.zeros((2, 17)), SIZE, GRID).any()
    assert draw(np.zeros((0, 17, 3)), np.zeros((0, 17)), SIZE, GRID).shape == (0, 17, *GRID)


@pytest.mark.parametrize(("u", "v"), [(-0.01, 20), (64.0, 20), (30, -0.01), (30, 48.0), (1e6, -1e6)])
def test_an_off_screen_joint_leaves_no_mass(u: float, v: float) -> None:
    assert not one(u, v).any()


def test_a_joint_at_the_border_is_cut_and_not_renormalised() -> None:
    inner, border = one(30.0, 22.0), one(0.0, 22.0)
    assert border.max() == pytest.approx(np.exp(-(2**2) / 72.0), abs=5e-4)
    assert border.sum() == pytest.approx(inner.sum() / 2, rel=0.01)


def test_mass_is_that_of_a_gaussian() -> None:
    found = one(31.3, 24.9, 0.7, 6.0, (128, 128), (32, 32)).astype(np.float64).sum()
    assert found == pytest.approx(0.7 * 2 * np.pi * (6 / 4) ** 2, rel=0.01)  # the tail below 1e-3 is missing


def test_sigma_to_zero_still_leaves_a_peak_in_the_joints_cell() -> None:
    for u, v in ((30.0, 22.0), (28.01, 20.01), (31.99, 23.99)):
        found = one(u, v, 1.0, sigma=0.0)
        assert np.isfinite(found).all()
        assert np.unravel_index(found.argmax(), GRID) == (5, 7)
        assert found.max() >= np.exp(-1.01)  # the corner of a cell is sqrt(8) px from its centre, sigma is 2 px


def test_padding_beyond_a_small_view_stays_empty() -> None:
    found = one(29.0, 30.0, size=(30, 32))
    assert found[:8, :8].any()
    assert not found[8:].any()
    assert not found[:, 8:].any()


def test_the_grid_is_the_largest_view_rounded_up() -> None:
    assert grid_of(np.array([[30, 65], [41, 64]])) == (17, 11)
