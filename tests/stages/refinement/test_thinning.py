"""Thinning keeps an even share of the Gaussians, in any part of the picture."""

import numpy as np
import pytest

from posegaussian.stages.refinement.params import EVERY, LEAST, VIEWS, pixels_a_gaussian
from posegaussian.stages.refinement.thinning import OPACITY, WIDER, thinned
from posegaussian.stages.rendering.lift import GaussianMaps


def maps(size: int = 96) -> GaussianMaps:
    rng = np.random.default_rng(0)
    return GaussianMaps(
        rng.integers(0, 256, (size, size, 3), np.uint8),
        rng.uniform(1, 2, (size, size)).astype(np.float32),
        rng.uniform(0.001, 0.002, (3, size, size)).astype(np.float16),
        rng.normal(size=(3, size, size)).astype(np.float16),
        np.where(rng.random((size, size)) < 0.9, np.float16(0.8), np.float16(0))[None].repeat(2, 0),
    )


@pytest.mark.parametrize("every", [3.0, 4.5, EVERY])
def test_a_share_is_left_everywhere_and_as_much_wider_and_nothing_else_changes(every: float) -> None:
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
    wider = WIDER * np.sqrt(every / EVERY)
    np.testing.assert_allclose(
        np.asarray(after.scale, np.float32), wider * np.asarray(before.scale, np.float32), rtol=1e-3
    )
    for name in ("color", "depth", "normal"):
        assert getattr(after, name) is getattr(before, name)


def test_neighbours_are_a_pixel_or_more_apart() -> None:
    left = np.argwhere(np.asarray(thinned(maps(), EVERY).opacity)[0] > 0)
    nearest = [np.sort(np.abs(left - p).max(axis=1))[1] for p in left[::7]]
    assert min(nearest) >= 2


def test_fewer_views_have_as_many_gaussians_in_all_but_for_very_few() -> None:
    every = [pixels_a_gaussian(v) for v in range(1, 2 * VIEWS)]
    assert every == sorted(every)
    assert every[0] == LEAST < EVERY == every[VIEWS - 1] == every[-1]
    for views, pixels in enumerate(every[:VIEWS], start=1):
        assert pixels == LEAST or views / pixels == pytest.approx(VIEWS / EVERY)
