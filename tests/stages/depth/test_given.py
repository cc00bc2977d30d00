"""Given depth: exact maps pass as they are, noise is smoothed within surfaces, what straddles two surfaces goes."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.depth.algorithms.given_depth import EDGE, given_depth, pixel_noise

FOCAL = 100.0


def slope(width: int = 40) -> np.ndarray:
    """[30, w] metres, a tilted plane: linear in inverse depth."""
    u, v = np.meshgrid(np.arange(width), np.arange(30))
    return (1 / (0.5 - 0.002 * u + 0.001 * v)).astype(np.float32)


def test_an_exact_map_passes_bit_by_bit_and_is_certain() -> None:
    z = slope()
    z[:5] = 0
    depth, confidence = given_depth(z, FOCAL, None)
    np.testing.assert_array_equal(depth, z)
    np.testing.assert_array_equal(confidence, z > 0)


def test_pixels_on_both_sides_of_an_edge_are_trusted_less_and_keep_their_depth() -> None:
    z = slope()
    z[:, 20:] += 2
    depth, confidence = given_depth(z, FOCAL, None)
    np.testing.assert_array_equal(depth, z)
    assert (confidence[:, 19:21] == EDGE).all()
    assert (np.delete(confidence, [19, 20], axis=1) == 1).all()


def test_what_lies_between_two_surfaces_goes() -> None:
    z = slope()
    z[:, 20:] += 2
    z[:, 20] -= 1
    depth, confidence = given_depth(z, FOCAL, None)
    assert not depth[:, 20].any()
    np.testing.assert_array_equal(depth > 0, confidence > 0)
    np.testing.assert_array_equal(np.delete(depth, 20, axis=1), np.delete(z, 20, axis=1))


def test_noise_shrinks_and_surfaces_stay_apart() -> None:
    z = slope()
    z[:, 20:] += 2
    z[:4] = 0
    noisy = np.where(z > 0, z * (1 + 0.01 * np.random.default_rng(1).normal(size=z.shape)), 0).astype(np.float32)
    depth, _ = given_depth(noisy, FOCAL, None)
    seen = depth > 0
    assert seen.sum() > 0.99 * (z > 0).sum()
    assert not depth[:4].any()
    before, after = (np.abs(a / np.maximum(z, 1) - 1)[seen].mean() for a in (noisy, depth))
    assert after < 0.4 * before  # a bilateral mean of 37 pixels leaves a third
    assert np.abs(depth - z)[seen].max() < 0.2, "surfaces 2 m apart are not mixed"


def test_the_noise_of_a_plane_is_none_and_that_of_noise_is_its_deviation() -> None:
    assert pixel_noise(1 / slope().astype(np.float64)) < 1e-7  # of float32
    noise = np.random.default_rng(2).normal(1.0, 0.01, (200, 200))
    np.testing.assert_allclose(pixel_noise(noise), 0.01, rtol=0.03)  # 40 000 samples
    assert pixel_noise(np.zeros((4, 4))) == 0


def test_depth_beyond_the_range_goes_and_an_empty_map_stays_empty() -> None:
    z = slope()
    depth, _ = given_depth(z, FOCAL, (2.0, 2.1))
    np.testing.assert_array_equal(depth > 0, (z >= 2.0) & (z <= 2.1))
    nothing, confidence = given_depth(np.zeros((4, 5), np.float32), FOCAL, None)
    assert not nothing.any()
    assert not confidence.any()
