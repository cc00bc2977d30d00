"""Noise of a picture: found as it was put on, on whatever smooth ground and beside edges; none where there is none."""

import numpy as np
import pytest

from posegaussian.stages.survey.algorithms.noise import PIXELS, noise_level


def ground() -> np.ndarray:
    rows, columns = np.mgrid[:200, :200]
    smooth = 60 + 0.4 * rows + 0.3 * columns
    return np.repeat(np.where((columns // 40) % 2 == 1, smooth, 230 - smooth)[..., None], 3, axis=2)


@pytest.mark.parametrize("sigma", [2.0, 6.0, 15.0])
def test_noise_is_found(sigma: float) -> None:
    noisy = np.clip(np.rint(ground() + np.random.default_rng(0).normal(0, sigma, (200, 200, 3))), 0, 255).astype(
        np.uint8
    )
    assert noise_level(noisy) == pytest.approx(sigma, rel=0.1)


def test_a_clean_picture_has_the_noise_of_rounding_and_a_black_one_none() -> None:
    assert noise_level(np.rint(ground()).astype(np.uint8)) < 0.6
    assert noise_level(np.zeros((20, 20, 3), np.uint8)) == 0


def test_strips_of_a_large_picture_tell_what_the_whole_does() -> None:
    """Quiet above, noisy below: the median of the whole, to a few per cent, as strips lie all over it."""
    rng = np.random.default_rng(1)
    picture = np.clip(
        np.rint(128 + rng.normal(0, 1, (1200, 900, 3)) * np.linspace(2, 8, 1200)[:, None, None]), 0, 255
    ).astype(np.uint8)
    quarters = [noise_level(np.ascontiguousarray(picture[:, c : c + 200])) for c in range(0, 800, 200)]
    assert 200 * 1200 < PIXELS < 900 * 1200
    assert noise_level(picture) == pytest.approx(np.median(quarters), rel=0.03)
