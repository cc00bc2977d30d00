"""Thinning keeps an even sixth of the Gaussians, in any part of the picture."""

import numpy as np

from posegaussian.stages.refinement.thinning import EVERY, OPACITY, WIDER, thinned
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


def test_a_sixth_is_left_everywhere_twice_as_wide_and_nothing_else_changes() -> None:
    before = maps()
    after = thinned(before)
    some, left = np.asarray(before.opacity)[0] > 0, np.asarray(after.opacity)[0] > 0
    assert not (left & ~some).any()
    for rows in np.split(np.arange(96), 4):
        for columns in np.split(np.arange(96), 4):
            part = np.ix_(rows, columns)
            # 24 x 24 pixels hold 96 places of the lattice, a tenth of them without a Gaussian;
            # an even one misses by a few
            assert abs(left[part].sum() - some[part].sum() / EVERY) < 9
    assert set(np.unique(np.asarray(after.opacity))) == {0, np.float16(OPACITY)}
    # float16
    np.testing.assert_allclose(
        np.asarray(after.scale, np.float32), WIDER * np.asarray(before.scale, np.float32), rtol=1e-3
    )
    for name in ("color", "depth", "normal"):
        assert getattr(after, name) is getattr(before, name)


def test_neighbours_are_a_pixel_or_more_apart() -> None:
    left = np.argwhere(np.asarray(thinned(maps()).opacity)[0] > 0)
    nearest = [np.sort(np.abs(left - p).max(axis=1))[1] for p in left[::7]]
    assert min(nearest) >= 2
