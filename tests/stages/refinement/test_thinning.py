"""Thinning keeps as many of the Gaussians as were asked for: evenly where the picture is plain, more where it has
detail."""

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.refinement.params import EVERY, LEAST, VIEWS, RefinementParams, pixels_a_gaussian
from posegaussian.stages.refinement.thinning import DENSEST, OPACITY, SPARSEST, WIDER, shares, thinned
from posegaussian.stages.rendering.lift import GaussianMaps


def maps(size: int = 96) -> GaussianMaps:
    """Of one colour."""
    rng = np.random.default_rng(0)
    return GaussianMaps(
        np.full((size, size, 3), (200, 120, 40), np.uint8),
        rng.uniform(1, 2, (size, size)).astype(np.float32),
        rng.uniform(0.001, 0.002, (3, size, size)).astype(np.float16),
        rng.normal(size=(3, size, size)).astype(np.float16),
        np.where(rng.random((size, size)) < 0.9, np.float16(0.8), np.float16(0))[None].repeat(2, 0),
    )


def striped(size: int = 96) -> tuple[np.ndarray, np.ndarray]:
    """(color [h, w, 3] uint8, some [h, w] bool): a person of whom the left half is plain and the right half is
    striped."""
    color = np.full((size, size, 3), 90, np.uint8)
    color[:, size // 2 :][:, ::4] = 180
    some = np.zeros((size, size), bool)
    some[8:-8, 8:-8] = True
    return color, some


@pytest.mark.parametrize("every", [2.7, 4.5, EVERY])
def test_of_a_plain_picture_a_share_is_left_everywhere_and_as_much_wider_and_nothing_else_changes(every: float) -> None:
    before = maps()
    after = thinned(before, every)
    some, left = np.asarray(before.opacity)[0] > 0, np.asarray(after.opacity)[0] > 0
    assert not (left & ~some).any()
    for rows in np.split(np.arange(96), 4):
        for columns in np.split(np.arange(96), 4):
            part = np.ix_(rows, columns)
            # 24 x 24 pixels hold 96 to 192 places of the lattice, a tenth of them without a Gaussian;
            # an even one misses by a few
            assert abs(left[part].sum() - some[part].sum() / every) < 12
    assert set(np.unique(np.asarray(after.opacity))) == {0, np.float16(OPACITY)}
    # gaps between neighbours grow with the root of the pixels that share one; float16
    wider = np.asarray(after.scale, np.float32)[:, left] / np.asarray(before.scale, np.float32)[:, left]
    np.testing.assert_allclose(wider, WIDER * np.sqrt(every / EVERY), rtol=2e-3)
    for name in ("color", "depth", "normal"):
        assert getattr(after, name) is getattr(before, name)


def test_neighbours_of_a_plain_picture_are_a_pixel_or_more_apart() -> None:
    left = np.argwhere(np.asarray(thinned(maps(), EVERY).opacity)[0] > 0)
    nearest = [np.sort(np.abs(left - p).max(axis=1))[1] for p in left[::7]]
    assert min(nearest) >= 2


@pytest.mark.parametrize("every", [2.7, EVERY, 12.0, 36.0])
def test_as_many_are_left_wherever_they_stand(every: float) -> None:
    """One of `every` pixels, more where there is detail, never outside of the person or of the bounds."""
    color, some = striped()
    share = shares(color, some, every)
    assert share[some].mean() == pytest.approx(1 / every, rel=1e-6)
    assert not share[~some].any()
    assert share[some].min() >= 1 / SPARSEST
    assert share[some].max() <= 1 / DENSEST
    plain, stripes = share[16:-16, 16:40], share[16:-16, 56:-16]
    assert stripes.min() > 1.5 * plain.max() or every == 36  # where few may stand closer than the rest
    opacity = np.where(some, np.float16(0.8), np.float16(0))[None].repeat(2, 0)
    left = np.asarray(thinned(replace(maps(), color=color, opacity=opacity), every).opacity)[0] > 0
    assert abs(left.sum() / some.sum() * every - 1) < 0.05  # 6400 pixels


def test_what_is_beside_the_person_and_how_bright_the_light_is_have_no_say() -> None:
    color, some = striped()
    share = shares(color, some, EVERY)
    beside = np.where(some[..., None], color, np.random.default_rng(0).integers(0, 256, color.shape, np.uint8))
    assert np.array_equal(share, shares(beside, some, EVERY))
    np.testing.assert_allclose(share, shares(color + np.uint8(40), some, EVERY), rtol=1e-4)  # float32 slopes
    np.testing.assert_allclose(share[:, ::-1], shares(color[:, ::-1].copy(), some[:, ::-1], EVERY), rtol=1e-4)


def test_nobody_keeps_nothing() -> None:
    color, some = striped()
    assert not shares(color, np.zeros_like(some), EVERY).any()


def test_fewer_views_have_as_many_gaussians_in_all_but_for_very_few() -> None:
    params = RefinementParams(every=10)
    every = [pixels_a_gaussian(v, params) for v in range(1, 2 * VIEWS)]
    assert every == sorted(every)
    assert every[0] == LEAST * 10 < 10 == every[VIEWS - 1] == every[-1]
    for views, pixels in enumerate(every[:VIEWS], start=1):
        assert pixels == LEAST * 10 or views / pixels == pytest.approx(VIEWS / 10)
