"""The catalogue of measures, L1-L7 where the code is there; tests/stages/metrics states the definitions."""

import numpy as np
import pytest

from posegaussian.stages.metrics.depth_error import depth_error, disparity_error, nearest_pair
from posegaussian.stages.metrics.measures.ms_ssim import ms_ssim
from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.metrics.measures.ssim import ssim_map
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from tests.hard_cases.cases_metrics import depths, nearly_constant, network, noisy_pair, picture
from tests.support.known_geometry import ring


@pytest.mark.parametrize("level", [0.0, 1e-3, 0.6, 1.0])
def test_l1_nearly_constant_pictures_are_similar_and_no_more_than_equal(level: float) -> None:
    x, y = nearly_constant(level)
    for scale in (1.0, 255.0):
        assert ssim_map(scale * x, scale * y, scale).max() <= 1 + 1e-12
        assert np.abs(ssim_map(scale * x, scale * x, scale) - 1).max() < 1e-12


def test_l1b_ms_ssim_of_opposites_is_0_in_either_order() -> None:
    x = picture()
    assert ms_ssim(x, 255 - x, 255.0) == ms_ssim(255 - x, x, 255.0) == 0


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_l2_identical_pictures_have_the_cap_in_any_type(dtype: type) -> None:
    """A difference too small to be seen is capped, too: the mean cannot be moved by what is below a bit."""
    x = picture().astype(dtype)
    assert psnr(x, x, 255.0, 100.0) == 100.0
    assert psnr(x.astype(np.float64), x + 1e-9, 255.0, 100.0) == 100.0


def test_l3_lpips_is_no_less_than_0_and_refuses_what_is_too_small() -> None:
    a, b = noisy_pair()
    assert network().distance(a, a, 255.0) == 0
    assert network().distance(a, b, 255.0) > 0
    assert network().distance(a / 255, b / 255, 1.0) == pytest.approx(network().distance(a, b, 255.0), rel=1e-5)
    with pytest.raises(ValueError, match="31 px or more"):
        network().distance(a[:30], b[:30], 255.0)


def test_l4_the_range_is_part_of_the_measure() -> None:
    """8-bit pictures enter as 0..255 with that range, whatever they hold: dark pictures are not stretched."""
    dark = np.full((16, 16, 3), 3, np.uint8)
    values = measure(dark, np.zeros_like(dark), np.full((16, 16), 255, np.uint8), MetricsParams(measures=["ssim"]))
    assert values["full", "ssim"] == pytest.approx(2.55**2 / (9 + 2.55**2))


def test_l7_pixels_without_truth_cost_nothing_and_those_without_depth_a_fixed_sum() -> None:
    depth, truth = depths()
    rig, pair = ring(8, (64, 48)), nearest_pair(ring(8, (64, 48)), 0, range(8))
    everywhere = np.full(truth.shape, 255, np.uint8)
    assert not disparity_error(depth, truth, pair)[truth == 0].any()
    assert np.isfinite(disparity_error(np.zeros_like(depth), truth, pair)).all()
    assert depth_error(depth, np.zeros_like(truth), everywhere, rig, 0, range(8)) is None
