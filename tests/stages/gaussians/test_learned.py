"""The heads over the prior of one picture: numbers of 0 and a confidence of 0 are the prior itself."""

import numpy as np
import pytest

from posegaussian.stages.gaussians.learned import CHANNELS, over_prior
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.prior import rays
from posegaussian.stages.gaussians.run import prior
from posegaussian.stages.network.inference import HEADS, NUMBERS

K = np.array([[60.0, 0, 21.0], [0, 55.0, 14.0], [0, 0, 1]])
SHAPE = (30, 40)
Picture = tuple[np.ndarray, np.ndarray, np.ndarray]


def picture() -> Picture:
    """Prior of a wavy surface with a hole."""
    rows, columns = np.mgrid[:30, :40]
    depth = (2 + 0.05 * np.sin(rows / 4) + 0.004 * columns).astype(np.float32)
    depth[5:12, 20:30] = 0
    confidence = np.random.default_rng(0).uniform(0.1, 1, SHAPE).astype(np.float16)
    return prior(depth, confidence, np.full(SHAPE, 255, np.uint8), K, GaussiansParams())


def numbers(size: float) -> np.ndarray:
    return np.clip(size * np.random.default_rng(1).normal(size=(NUMBERS, *SHAPE)), -6e4, 6e4).astype(np.float16)


@pytest.mark.parametrize("size", [0.0, 3.0, 6e4])
def test_a_confidence_of_0_is_the_prior_to_the_bit(size: float) -> None:
    p = picture()
    *found, share = over_prior(p, numbers(size), np.zeros(SHAPE, np.float16), K)
    for ours, theirs in zip(found, p, strict=True):
        assert np.asarray(ours, np.float32).tobytes() == np.asarray(theirs, np.float32).tobytes()
    assert not share.any()


@pytest.mark.parametrize("confidence", [0.3, 1.0])
def test_numbers_of_0_are_the_prior(confidence: float) -> None:
    """But for rounding, and where a normal is seen at a flatter angle than a learned one may be: here none is."""
    p = picture()
    scale, normal, opacity, share = over_prior(p, numbers(0.0), np.full(SHAPE, confidence, np.float16), K)
    assert ((p[1] * rays(K, *SHAPE)).sum(axis=0)[p[2][0] > 0] < -0.5).all()
    for ours, theirs in zip((scale, normal, opacity), p, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=2e-7)
    assert share.shape == (1, *SHAPE)
    np.testing.assert_array_equal(share[0] > 0, p[2][0] > 0)


def test_each_head_changes_its_own_map_and_none_makes_a_surface() -> None:
    p = picture()
    assert tuple(CHANNELS) == HEADS
    everywhere = np.ones(SHAPE, np.float16)
    for i, channels in enumerate(CHANNELS.values()):
        said = numbers(0.0)
        said[channels] = 1.5
        found = over_prior(p, said, everywhere, K)
        for j, (ours, theirs) in enumerate(zip(found, p, strict=False)):
            assert np.allclose(ours, theirs, rtol=2e-6, atol=2e-7) == (i != j)
            assert not ours[:, p[2][0] == 0].any()
            assert np.isfinite(ours).all()


def test_a_share_of_the_learned_value_is_a_share_of_the_change() -> None:
    p, said = picture(), numbers(1.0)
    full, half = (over_prior(p, said, np.full(SHAPE, c, np.float16), K) for c in (1.0, 0.5))
    for k in (0, 2):
        np.testing.assert_allclose(half[k] - p[k], (full[k] - p[k]) / 2, atol=1e-6)
    length = np.sqrt((half[1] ** 2).sum(axis=0))
    np.testing.assert_allclose(length[p[2][0] > 0], 1, rtol=1e-5)


def test_a_quaternion_of_no_turn_is_the_prior_and_one_about_the_normal_leaves_it() -> None:
    p, everywhere = picture(), np.ones(SHAPE, np.float16)
    none, turn = numbers(0.0), np.zeros((1, *SHAPE), np.float16)
    scale, normal, opacity, _, twist = over_prior(p, none, everywhere, K, turn)
    for ours, theirs in zip((scale, normal, opacity), p, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=4e-7)
    np.testing.assert_allclose(twist, np.broadcast_to([[[1]], [[0]]], twist.shape), atol=1e-6)
    said = numbers(0.0)
    said[5] = 1.5  # k, the Gaussian's own third axis
    _, normal, _, _, twist = over_prior(p, said, everywhere, K, turn)
    np.testing.assert_allclose(normal, p[1], atol=1e-6)
    surface = p[2][0] > 0
    half = np.arctan(1.5 / (1 + 1.5 / 6))  # growth of 0 is 1, a number is limited by 6
    np.testing.assert_allclose(twist[0][surface], np.cos(2 * half), atol=1e-5)
    np.testing.assert_allclose(twist[1][surface], np.sin(2 * half), atol=1e-5)
    np.testing.assert_array_equal(twist[:, ~surface], np.broadcast_to([[1], [0]], (2, (~surface).sum())))


def test_a_single_opacity_is_the_same_from_everywhere() -> None:
    p, said = picture(), numbers(0.0)
    said[6] = 0.7
    opacity = over_prior(p, said, np.ones(SHAPE, np.float16), K, None, True)[2]
    np.testing.assert_array_equal(opacity[0], opacity[1])
    assert (opacity[0][p[2][0] > 0] > p[2][0][p[2][0] > 0]).all()
