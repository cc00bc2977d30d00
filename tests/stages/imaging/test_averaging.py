"""Pictures and depth averaged over time: noise of what stands still goes by the root of their number, motion stays as
filmed."""

import numpy as np
import pytest

from posegaussian.stages.imaging.averaging import REACH, averaged, averaged_depth, sameness
from posegaussian.stages.survey.algorithms.noise import unrest

SIGMA = 4.0


def scene(shift: int = 0) -> np.ndarray:
    """Stripes in front of a slope, [96, 96, 3]; the upper third of the stripes moves along."""
    rows, columns = np.mgrid[:96, :96]
    moving = (rows < 32) * shift
    stripes = 60.0 * (((columns - moving) // 12) % 2)
    return np.repeat((70 + 0.5 * rows + stripes)[..., None], 3, axis=2)


def filmed(number: int, shift: int = 0, sigma: float = SIGMA) -> np.ndarray:
    noise = np.random.default_rng(number).normal(0, sigma, (96, 96, 3))
    return np.clip(np.rint(scene(shift) + noise), 0, 255).astype(np.uint8)


def test_noise_of_what_stands_still_falls_by_the_root_of_the_pictures() -> None:
    out = averaged(filmed(0), [filmed(i) for i in range(1, 7)], SIGMA)
    left = (out - scene()).std()
    # weights fall a little where a neighbourhood differs by chance, and the result is rounded
    assert SIGMA / np.sqrt(7) <= left < 1.25 * SIGMA / np.sqrt(7) + 0.1


def test_what_moves_stays_as_it_was_filmed() -> None:
    own = filmed(0)
    out = averaged(own, [filmed(i, shift=12) for i in range(1, 7)], SIGMA)
    # stripes have changed places: 60 of 255 are 15 standard deviations
    np.testing.assert_array_equal(out[:28], own[:28])
    assert np.abs(out[40:].astype(int) - own[40:]).mean() > 1


def test_the_order_of_the_others_does_not_matter_and_equal_pictures_change_nothing() -> None:
    own, others = filmed(0), [filmed(i) for i in range(1, 5)]
    there, back = (averaged(own, o, SIGMA).astype(int) for o in (others, others[::-1]))
    assert np.abs(there - back).max() <= 1, "sums of floats in another order round alike but for ties"
    np.testing.assert_array_equal(averaged(own, [own] * 6, SIGMA), own)


@pytest.mark.parametrize("others", [[], [filmed(1)]])
def test_without_noise_or_without_others_it_is_the_picture(others: list[np.ndarray]) -> None:
    own = filmed(0)
    np.testing.assert_array_equal(averaged(own, others, 0.0 if others else SIGMA), own)


@pytest.mark.parametrize("sigma", [1.0, 4.0, 10.0])
@pytest.mark.parametrize("shift", [0, 12])
def test_noise_from_frame_to_frame_is_found_though_a_third_of_the_picture_moves(sigma: float, shift: int) -> None:
    found = unrest(filmed(1, 0, sigma), filmed(2, shift, sigma))
    # values are whole steps, which tells at a noise of one; and of what is left still, the quietest quarter of all
    # pixels is the quietest 3/8, whose quantile is a fifth higher
    assert 0.88 * sigma < found < 1.35 * sigma


def test_still_clean_pictures_and_black_ones_have_no_noise() -> None:
    clean = np.rint(scene()).astype(np.uint8)
    assert unrest(clean, clean) == 0
    assert unrest(np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 255, np.uint8)) == 0


NEAR, FAR, FOOTPRINT = 3.0, 3.5, 1 / 500
SAME = np.ones((7, 20, 20), np.float32)


def found(sigma: float) -> np.ndarray:
    """[7, 20, 20] depths of a plane; noise of a share `sigma` of a pixel's footprint."""
    return (NEAR + NEAR * FOOTPRINT * np.random.default_rng(0).normal(0, sigma, SAME.shape)).astype(np.float32)


def test_noise_of_depth_falls_by_the_root_of_the_frames() -> None:
    depth, sure = averaged_depth(found(0.5), 0.5 * SAME, SAME, 3, FOOTPRINT)
    # weights fall with the distance from the median: a little more is left than of a mean
    assert (depth - NEAR).std() < 1.2 / np.sqrt(7) * 0.5 * NEAR * FOOTPRINT
    assert abs((depth - NEAR).mean()) < 0.05 * NEAR * FOOTPRINT
    np.testing.assert_allclose(sure, 0.5, rtol=1e-6)


def test_a_match_that_flips_to_another_surface_is_overruled_and_nothing_lies_between_the_two() -> None:
    depths = np.full_like(SAME, NEAR)
    depths[[0, 3, 5]] = FAR
    assert FAR - NEAR > REACH * FAR * FOOTPRINT
    for own in (2, 3):
        np.testing.assert_allclose(averaged_depth(depths, SAME, SAME, own, FOOTPRINT)[0], NEAR, rtol=1e-6)
    depths[2] = FAR  # now most have it
    np.testing.assert_allclose(averaged_depth(depths, SAME, SAME, 3, FOOTPRINT)[0], FAR, rtol=1e-6)


def test_what_moves_keeps_the_depth_of_its_frame_and_what_has_none_keeps_none() -> None:
    depths, confidences = found(0.5), np.linspace(0.3, 1, SAME.size, dtype=np.float32).reshape(SAME.shape)
    depths[3, :5] = 0
    shown = [filmed(0)[:20, :20], *(filmed(i, shift=12)[:20, :20] for i in range(1, 7))]
    order = [1, 2, 3, 0, 4, 5, 6]
    weights = np.stack([sameness(shown[0], shown[i], 1.0) for i in order])
    depth, sure = averaged_depth(depths, confidences, weights, 3, FOOTPRINT)
    moving = weights.sum(axis=0) < 1 + 1e-3  # stripes have changed places there
    assert moving.mean() > 0.5
    for ours, own in ((depth, depths[3]), (sure, np.where(depths[3] > 0, confidences[3], 0))):
        np.testing.assert_allclose(ours[moving], own[moving], rtol=1e-4)
    assert not depth[:5].any()
    assert (depth[5:] > 0).all()
