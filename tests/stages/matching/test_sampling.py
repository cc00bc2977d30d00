import numpy as np
import pytest

from posegaussian.stages.matching.fuse import transfer
from posegaussian.stages.matching.sampling import disagreement, extend, fill, sample
from tests.support.known_geometry import ring, sphere_depth


def test_sampling_is_exact_on_a_ramp_and_leaves_unknown_pixels_out():
    ramp = 1000 + np.arange(12, dtype=np.float32).reshape(3, 4)
    xs, ys = np.array([[0.25, 1.5, 3.0]]), np.array([[0.5, 1.25, 2.0]])
    np.testing.assert_allclose(sample(ramp, xs, ys, 0.02), 1000 + xs + 4 * ys, rtol=1e-6)
    holed = ramp.copy()
    holed[0, 0] = 0
    assert sample(holed, np.array([[0.0]]), np.array([[0.0]]), 0.02)[0, 0] == 0
    assert 1001 < sample(holed, np.array([[0.5]]), np.array([[0.5]]), 0.02)[0, 0] < 1005


def test_sampling_does_not_blend_two_surfaces():
    step = np.array([[1.0, 1.0, 2.0, 2.0]], np.float32)
    found = sample(step, np.array([[1.2, 1.4, 1.6, 1.9]]), np.zeros((1, 4)), 0.02)
    assert found[0].tolist() == [1, 1, 2, 2]


def test_sampling_outside_is_unknown_even_for_positions_that_are_no_numbers():
    values = np.ones((3, 3), np.float32)
    assert not sample(values, np.array([[-1.5, 3.2, np.nan, np.inf]]), np.ones((1, 4)), 0.02).any()


def test_extend_takes_the_nearest_known_pixel():
    values = np.array([[5, 0, 0, 0, 9]])
    assert extend(values, values > 0).tolist() == [[5, 5, 5, 9, 9]] or extend(values, values > 0).tolist() == [
        [5, 5, 9, 9, 9]
    ]
    nothing = np.zeros((2, 2))
    assert extend(nothing, nothing > 0) is nothing


def test_a_gap_belongs_to_the_farther_surface():
    mask = np.ones((1, 6), bool)
    inverse = np.array([[0.5, 0, 0, 0, 0, 0.25]], np.float32)
    assert fill(inverse, mask)[0].tolist() == [0.5, 0.25, 0.25, 0.25, 0.25, 0.25]
    # Neighbours of one surface are interpolated by distance.
    close = np.array([[0.50, 0, 0, 0.515]], np.float32)
    np.testing.assert_allclose(fill(close, mask[:, :4])[0], [0.5, 0.505, 0.51, 0.515], rtol=1e-6)


def test_filling_does_not_cross_the_background():
    mask = np.array([[True, False, True]])
    assert fill(np.array([[0.5, 0, 0]], np.float32), mask)[0].tolist() == [0.5, 0, 0]


@pytest.mark.parametrize("error", [0.0, 2.0])
def test_disagreement_of_true_depths_is_the_error_put_in(error: float) -> None:
    rig = ring(16, (96, 80), 90.0)
    a, b = (sphere_depth(rig, v, np.zeros(3), 0.6).astype(np.float32) for v in (0, 1))
    scale = 70.0
    wrong = np.where(b > 0, 1 / (1 / np.where(b > 0, b, 1) + error / scale), 0).astype(np.float32)
    found = disagreement(a, wrong, transfer(rig, 0, 1), scale)
    seen = np.isfinite(found) & (a > 0)
    assert seen.sum() > 0.8 * (a > 0).sum()
    # The pixel grid of the other view: at most half a pixel of slope, less by taking the best of nine.
    middle = np.abs(np.median(found[seen]) - error)
    assert middle < 0.5
    assert np.isinf(disagreement(a, np.zeros_like(b), transfer(rig, 0, 1), scale)).all()
