"""Peaks to a fraction of a cell: exact for Gaussians."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.estimators.peaks import bin_peaks, heatmap_peaks


def gaussians(places: np.ndarray, covariance: np.ndarray, h: int = 48, w: int = 36) -> np.ndarray:
    i, j = np.mgrid[:h, :w]
    d = np.stack([j, i], -1)[None] - places[:, None, None]
    return np.exp(-np.einsum("jhwa,ab,jhwb->jhw", d, np.linalg.inv(covariance), d) / 2)


@pytest.mark.parametrize("covariance", [np.eye(2) * 4, np.array([[6.0, 2.5], [2.5, 2.0]])])
def test_the_peak_of_a_gaussian_is_exact(covariance: np.ndarray) -> None:
    places = np.random.default_rng(0).uniform(4, 30, (20, 2))
    found, values = heatmap_peaks(gaussians(places, covariance))
    assert np.abs(found - places).max() < 1e-6
    assert (values > 0.8).all()


def test_a_peak_on_the_rim_stays_at_its_cell() -> None:
    maps = np.zeros((2, 8, 8))
    maps[0, 0, 3] = maps[1, 5, 7] = 1
    found, values = heatmap_peaks(maps)
    assert found.tolist() == [[3, 0], [7, 5]]
    assert values.tolist() == [1, 1]


def test_the_peak_of_bins_is_exact_for_a_gaussian_s_logarithm() -> None:
    places = np.random.default_rng(1).uniform(3, 90, 20)
    logs = -((np.arange(96)[None] - places[:, None]) ** 2) / (2 * 5.0**2) + 3
    assert np.abs(bin_peaks(logs) - places).max() < 1e-9


def test_bins_at_the_end_stay() -> None:
    assert bin_peaks(np.array([[3.0, 2, 1, 0], [0, 1, 2, 3], [1, 1, 1, 1]])).tolist() == [0, 3, 0]
