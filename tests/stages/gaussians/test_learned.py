"""The heads over the prior of one picture: numbers of 0 and a confidence of 0 are the prior itself."""

import numpy as np
import pytest
import torch

from posegaussian.stages.gaussians.learned import CHANNELS, over_prior, turned_sizes
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


def spread(scale: torch.Tensor, twist: torch.Tensor) -> torch.Tensor:
    """[B, h, w, 2, 2] symmetric matrices of standard deviations along the tangents, turned by the twist."""
    c, s = twist.unbind(dim=1)
    axes = torch.stack([torch.stack([c, -s], dim=-1), torch.stack([s, c], dim=-1)], dim=-2)
    return axes @ torch.diag_embed(torch.stack([scale[:, 0], scale[:, 1]], dim=-1)) @ axes.transpose(-1, -2)


def sizes() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(0)
    prior, growth = (torch.rand((1, 3, 6, 7), generator=rng, dtype=torch.float64) + 0.1 for _ in range(2))
    return prior, growth, torch.rand((1, 1, 6, 7), generator=rng, dtype=torch.float64)


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4, -0.7, np.pi / 2])
def test_sizes_along_turned_axes_are_blended_with_the_priors_as_matrices(angle: float) -> None:
    prior, growth, share = sizes()
    scale, twist = turned_sizes(prior, growth, share, angle)
    c, s = np.cos(angle), np.sin(angle)
    axes = torch.tensor([[c, s], [-s, c]])  # of the tangents (x, -y): a turn from x towards y takes x to (c, -s)
    own = torch.diag_embed(prior[:, :2].movedim(1, -1))
    along = torch.diagonal(axes.T @ own @ axes, dim1=-2, dim2=-1) * growth[:, :2].movedim(1, -1)
    expected = (1 - share[:, 0, ..., None, None]) * own + share[:, 0, ..., None, None] * (
        axes @ torch.diag_embed(along) @ axes.T
    )
    np.testing.assert_allclose(spread(scale, twist), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(scale[:, 2], (1 - share[:, 0] + share[:, 0] * growth[:, 2]) * prior[:, 2], rtol=1e-9)
    assert (torch.cos(2 * (torch.atan2(twist[:, 1], twist[:, 0]) + angle / 2)) >= 0).all()


def test_without_a_turn_every_size_is_blended_by_itself_and_nothing_is_twisted() -> None:
    prior, growth, share = sizes()
    scale, twist = turned_sizes(prior, growth, share, 0.0)
    np.testing.assert_allclose(scale, (1 - share) * prior + share * growth * prior, rtol=1e-12)
    np.testing.assert_array_equal(twist[:, 0], 1)
    np.testing.assert_array_equal(twist[:, 1], 0)


def test_along_turned_axes_a_confidence_of_0_is_the_prior_and_a_normal_leans_as_it_is_said() -> None:
    p = picture()
    *found, _, twist = over_prior(p, numbers(3.0), np.zeros(SHAPE, np.float16), K, axes=np.array([0.6], np.float32))
    for ours, theirs in zip(found, p, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=1e-7)
    np.testing.assert_allclose(np.hypot(*twist), 1, rtol=1e-6)
    said, turned = numbers(0.0), numbers(0.0)
    said[3], turned[4] = 0.5, 0.5  # towards x; along axes turned by a quarter, x is where -y was
    everywhere = np.ones(SHAPE, np.float16)
    plain = over_prior(p, said, everywhere, K)[1]
    quarter = over_prior(p, turned, everywhere, K, axes=np.array([np.pi / 2], np.float32))[1]
    np.testing.assert_allclose(quarter, plain, rtol=1e-5, atol=1e-6)
