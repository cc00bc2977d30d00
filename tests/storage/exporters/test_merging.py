"""Merged pixels: fewer Gaussians that show the same, each of the surface in front."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.storage.exporters.page.maps import ViewMaps, coded
from posegaussian.storage.exporters.page.merging import merged
from tests.storage.exporters.test_page import maps


def wall(height: int = 6, width: int = 10) -> ViewMaps:
    x = np.arange(width)[None].repeat(height, 0)
    color = np.stack([10 * x, 20 * x, 255 - 10 * x], axis=-1).astype(np.uint8)
    normal = np.zeros((3, height, width)) - [[[0]], [[0]], [[1]]]
    return ViewMaps(
        color, np.full((height, width), 2.0), np.full((3, height, width), 0.01), normal,
        np.full((2, height, width), 0.8), None, 100.0,
    )  # fmt: skip


def test_a_wall_stays_a_wall() -> None:
    small = merged(wall(), 2)
    assert small.depth.shape == (3, 5)
    np.testing.assert_allclose(small.depth, 2)
    np.testing.assert_allclose(small.scale, 0.02)
    np.testing.assert_allclose(small.opacity, 0.8)
    np.testing.assert_allclose(small.normal[2], -1)
    np.testing.assert_array_equal(small.color[0, :, 1], [10, 50, 90, 130, 170])
    assert small.focal == 50
    assert small.shift is None
    beside = np.stack([np.full((6, 10), 0.5), np.full((6, 10), -1.0)])
    np.testing.assert_allclose(
        merged(replace(wall(), shift=beside), 2).shift, [np.full((3, 5), x) for x in (0.25, -0.5)]
    )
    assert coded(small).count == 15
    assert merged(wall(), 1).depth.shape == (6, 10)


def test_the_surface_in_front_is_taken_and_what_shows_nothing_thins() -> None:
    given = wall(4, 6)
    given.depth[:2, :2] = [[1.0, 2.0], [2.0, 0.0]]  # a finger before the wall, and a hole
    given.color[0, 0] = 200
    given.depth[:2, 2:4] = 0
    given.depth[2, 2] = 0
    small = merged(given, 2)
    assert small.depth[0, 0] == 1.0
    np.testing.assert_array_equal(small.color[0, 0], 200)
    np.testing.assert_allclose(small.opacity[:, 0, 0], 0.8 * 3 / 4)
    assert small.depth[0, 1] == 0
    np.testing.assert_allclose(small.opacity[:, 1, 1], 0.8 * 3 / 4)


@pytest.mark.parametrize("side", [2, 3])
def test_pictures_that_do_not_divide_and_values_that_are_not_finite(side: int) -> None:
    given = maps(twist=True)
    given.scale[0, 11, 15] = np.nan
    small = merged(given, side)
    assert small.depth.shape == (-(-23 // side), -(-31 // side))
    assert small.twist is not None
    assert all(np.isfinite(a).all() for a in (small.depth, small.scale, small.normal, small.opacity, small.twist))
    assert 0 < coded(small).count < 1.6 * (given.depth > 0).sum() / side**2
