"""Noise of a picture: found as it was put on, on whatever smooth ground and beside edges; none where there is none."""

import cv2
import numpy as np
import pytest

from posegaussian.stages.imaging.averaging import averaged
from posegaussian.stages.imaging.noise import OCTAVES, noise_at
from posegaussian.stages.survey.algorithms.noise import PIXELS, at_octaves, noise_level, unrest


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


def filmed(seed: int, sigma: float, side: int = 512) -> np.ndarray:
    """A still grey picture under noise."""
    noisy = np.random.default_rng(seed).normal(120, sigma, (side, side, 3))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [4.0, 12.0])
@pytest.mark.parametrize("measure", ["frame to frame", "one picture"])
def test_what_is_reduced_has_the_noise_that_is_left_of_it(sigma: float, measure: str) -> None:
    """At octaves as averages of so many pixels have it, and between them."""
    first, second = filmed(0, sigma), filmed(1, sigma)
    found = at_octaves(unrest, first, second) if measure == "frame to frame" else at_octaves(noise_level, first)
    assert found.shape == (OCTAVES,)
    # Half a step of 255 is what rounding adds at the smallest; the quietest quarter of rounded values errs by a tenth.
    np.testing.assert_allclose(found, sigma / 2.0 ** np.arange(OCTAVES), rtol=0.12, atol=0.3)
    assert noise_at(found, 1.0) == noise_at(found, 2.0) == found[0]
    assert noise_at(found, 0.5) == found[1]
    assert found[2] < noise_at(found, 1 / 3) < found[1]
    assert noise_at(found, 1 / 16) == found[3] / 2


def test_small_pictures_have_octaves_too() -> None:
    assert at_octaves(noise_level, filmed(0, 3.0, 8)).shape == (OCTAVES,)


def test_averaging_of_reduced_pictures_leaves_faint_motion_alone() -> None:
    """A faint stripe that moves, filmed under noise at four times the size it is worked on: told the noise that is
    left, averaging makes errors smaller; told that of the pictures as filmed it blurs the stripe into the ground."""

    def worked(at: int) -> tuple[np.ndarray, np.ndarray]:
        clean = np.full((512, 512, 3), 110.0)
        clean[:, 200 + 40 * at : 232 + 40 * at] += 10
        noisy = np.rint(clean + np.random.default_rng(at).normal(0, 6, clean.shape)).astype(np.uint8)
        return noisy, cv2.resize(noisy, (128, 128), interpolation=cv2.INTER_AREA)

    pictures = [worked(at) for at in range(5)]
    truth = np.full((128, 128), 110.0)
    truth[:, 70:78] += 10
    levels = at_octaves(unrest, pictures[2][0], pictures[3][0])

    def error(noise: float) -> float:
        others = [p for i, (_, p) in enumerate(pictures) if i != 2]
        off = averaged(pictures[2][1], others, noise).astype(float) - truth[..., None]
        return float(np.sqrt((off[:, 66:82] ** 2).mean()))

    assert error(noise_at(levels, 0.25)) < error(0.0) < error(noise_at(levels, 1.0))


@pytest.mark.parametrize("brighter", [0.8, 1.25])
def test_light_that_changes_is_no_noise(brighter: float) -> None:
    first, second = filmed(0, 4.0), np.random.default_rng(1).normal(120, 4.0, (512, 512, 3)) * brighter
    lit = np.clip(np.rint(second), 0, 255).astype(np.uint8)
    # Rounding and a quarter of the pixels, as above.
    assert unrest(first, lit) == pytest.approx(4.0, rel=0.15)
