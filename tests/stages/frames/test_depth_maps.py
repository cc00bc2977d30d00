"""Given depth on its way to `frames/*`:
bit by bit where nothing moves, exact on planes, and never between two surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.warp import Warp
from posegaussian.storage.model.cameras import Rig

LENS = np.array([-0.1, 0.02, 0.001, 0, 0, 0, 0, 0])
NORMAL, OFFSET = np.array([0.2, -0.1, 1.0]), 2.5
"""A plane, normal . X = offset, in camera axes."""


def rig(distortion: np.ndarray) -> Rig:
    k = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    return Rig(("cam",), k[None], distortion[None], np.eye(4)[None], np.array([[64, 48]]))


def warp(distortion: np.ndarray, size: int | None = None) -> Warp:
    source = rig(distortion)
    return Warp(0, (64, 48), source, frames_rig(source, size), np.array([1.0, 0.0, 0.0]))


def plane(centres: np.ndarray, k: np.ndarray) -> np.ndarray:
    """[h, w] depth of the plane at pixels [h, w, 2] without distortion."""
    ray = np.stack(
        [(centres[..., 0] - k[0, 2]) / k[0, 0], (centres[..., 1] - k[1, 2]) / k[1, 1], np.ones(centres.shape[:2])], -1
    )
    return OFFSET / (ray @ NORMAL)


def test_a_map_of_the_picture_s_size_passes_bit_by_bit() -> None:
    depth = np.random.default_rng(0).uniform(1, 5, (48, 64)).astype(np.float32)
    depth[10:20, 10:20] = 0
    np.testing.assert_array_equal(warp(np.zeros(8)).depth(depth), depth)


@pytest.mark.parametrize("size", [None, 40])
@pytest.mark.parametrize("resolution", [(64, 48), (32, 24), (128, 96)])
def test_a_plane_is_exact_at_every_resolution(size: int | None, resolution: tuple[int, int]) -> None:
    """Inverse depth is linear on it, so interpolation is exact inside the outermost centres of the map."""
    k = rig(np.zeros(8)).intrinsics[0]
    given = plane(pixel_centres(resolution) * (64 / resolution[0]), k).astype(np.float32)
    found = warp(np.zeros(8), size).depth(given)
    frames = frames_rig(rig(np.zeros(8)), size)
    expected = plane(pixel_centres(tuple(frames.size[0])), frames.intrinsics[0])
    np.testing.assert_allclose(found[1:-1, 1:-1], expected[1:-1, 1:-1], rtol=1e-6)  # float32


def test_undistorted_depth_is_that_of_the_straight_ray() -> None:
    """Depth along the axis does not change with the lens, only where it is seen."""
    from posegaussian.stages.imaging.camera_mapping import undistort

    k = rig(LENS).intrinsics[0]
    ideal = undistort((pixel_centres((64, 48)) - k[:2, 2]) / 60.0, LENS)
    given = plane(ideal * 60.0 + k[:2, 2], k).astype(np.float32)
    found = warp(LENS).depth(given)
    seen = found > 0
    assert seen.mean() > 0.9
    # the lens bends the plane within a pixel; a pixel off would be 3e-3
    np.testing.assert_allclose(found[seen], plane(pixel_centres((64, 48)), k)[seen], rtol=1e-3)


@pytest.mark.parametrize("distortion", [np.zeros(8), LENS], ids=["straight", "lens"])
def test_two_surfaces_and_nothing_are_never_mixed(distortion: np.ndarray) -> None:
    given = np.full((24, 32), 2.0, np.float32)
    given[:, 13:] = 4.0
    given[5:9] = 0
    for size in (None, 40):
        assert set(np.unique(warp(distortion, size).depth(given))) <= {0.0, 2.0, 4.0}
