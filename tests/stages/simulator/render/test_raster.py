"""The rasterizer against rays cast by formula, and what must not change a picture."""

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.simulator.render.light import SRGB, averaged, encode, shade
from posegaussian.stages.simulator.render.raster import NEAR, flat_normals, rasterize, shares, vertex_normals

K = np.array([[90.0, 0.0, 31.0], [0.0, 84.0, 33.5], [0.0, 0.0, 1.0]])
SIZE = (64, 66)


def pictured(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points[:, :2] / points[:, 2:] @ K[:2, :2].T + K[:2, 2], points[:, 2]])


def rays() -> np.ndarray:
    uv = pixel_centres(SIZE)
    return np.concatenate([(uv - K[:2, 2]) @ np.linalg.inv(K[:2, :2]).T, np.ones((*uv.shape[:2], 1))], axis=-1)


def ball(centre: np.ndarray, radius: float, n: int = 96) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    points = centre + radius * np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1).reshape(
        -1, 3
    )
    grid = np.arange(2 * n * n).reshape(n, 2 * n)
    quads = [grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]]
    return points, np.concatenate(
        [
            np.stack([quads[0], quads[1], quads[2]], -1).reshape(-1, 3),
            np.stack([quads[1], quads[3], quads[2]], -1).reshape(-1, 3),
        ]
    ).astype(np.int32)


SCENE = ball(np.array([0.1, -0.05, 2.5]), 0.6)


def test_depth_of_a_plane_is_exact() -> None:
    normal, offset = np.array([0.3, -0.2, 1.0]), 2.0
    xy = np.array([[-3.0, -3], [3, -3], [-3, 3], [3, 3]])
    points = np.column_stack([xy, offset - xy @ normal[:2]])
    depth, index = rasterize(pictured(points), np.array([[0, 1, 2], [1, 3, 2]], np.int32), *SIZE, 1)
    assert (index >= 0).all()
    np.testing.assert_allclose(depth, offset / (rays() @ normal), rtol=1e-12)
    found = flat_normals(points, np.array([[0, 1, 2], [1, 3, 2]], np.int32), index)
    np.testing.assert_allclose(found, np.broadcast_to(-normal / np.linalg.norm(normal), found.shape), atol=1e-6)


def test_depth_of_a_ball_is_the_quadratic_formula() -> None:
    points, tris = SCENE
    depth = rasterize(pictured(points), tris, *SIZE, 1)[0]
    d, centre = rays(), np.array([0.1, -0.05, 2.5])
    a, b = np.sum(d * d, axis=-1), d @ centre
    h = b * b - a * (centre @ centre - 0.36)
    expected = np.where(h > 0, (b - np.sqrt(np.maximum(h, 0))) / a, np.inf)
    both = np.isfinite(depth) & np.isfinite(expected)
    off = np.abs(depth[both] - expected[both])
    # a facet lies up to 0.16 mm inside the ball, 0.08 mm for each of its two chords;
    # at the rim the ray is tangent to it
    assert np.median(off) < 2e-4
    assert np.quantile(off, 0.95) < 3e-3
    assert (np.isfinite(depth) != np.isfinite(expected)).sum() <= 3


def test_a_pixel_is_seen_at_its_centre() -> None:
    """A triangle that covers x < 10.5 px from the left holds the centres of columns 0..9,
    and that of column 10 exactly."""
    for edge, columns in ((10.49, 10), (10.5, 11), (10.51, 11)):
        p = np.array([[-100.0, -100, 1], [edge, -100, 1], [edge, 300, 1], [-100, 300, 1]])
        index = rasterize(p, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 20, 20, 1)[1]
        assert (index >= 0).sum(axis=1).tolist() == [columns] * 20


def test_neighbours_leave_no_gap_and_shares_sum_to_one() -> None:
    points, tris = SCENE
    p = pictured(points)
    index = rasterize(p, tris, *SIZE, 4)[1]
    rows = [np.nonzero(r)[0] for r in index >= 0 if r.any()]
    assert all(len(r) == r[-1] - r[0] + 1 for r in rows), "a convex body has no holes"
    i, j = np.argwhere(index >= 0)[::37].T
    s = np.array([shares(p, tris[index[a, b]], (b + 0.5) / 4, (a + 0.5) / 4) for a, b in zip(i, j, strict=True)])
    np.testing.assert_allclose(s.sum(axis=1), 1.0, atol=1e-12)
    assert s.min() > -1e-9


@pytest.mark.parametrize("samples", [1, 3])
def test_the_order_of_triangles_decides_nothing(samples: int) -> None:
    points, tris = SCENE
    p, order = pictured(points), np.random.default_rng(0).permutation(len(tris))
    depth, index = rasterize(p, tris, *SIZE, samples)
    other, shuffled = rasterize(p, tris[order], *SIZE, samples)
    np.testing.assert_array_equal(depth, other)
    np.testing.assert_array_equal(np.where(index >= 0, index, -1), np.where(shuffled >= 0, order[shuffled], -1))


def test_parts_give_the_whole() -> None:
    points, tris = SCENE
    p = pictured(points)
    whole = rasterize(p, tris, *SIZE, 2)[0]
    np.testing.assert_array_equal(
        whole, np.minimum(rasterize(p, tris[::2], *SIZE, 2)[0], rasterize(p, tris[1::2], *SIZE, 2)[0])
    )


def test_what_reaches_behind_the_camera_is_left_out() -> None:
    p = np.array([[0.0, 0, 1], [60, 0, 1], [0, 60, NEAR / 2]])
    assert (rasterize(p, np.array([[0, 1, 2]], np.int32), *SIZE, 1)[1] < 0).all()


def test_normals_of_a_ball_point_outwards_from_its_middle() -> None:
    points, tris = SCENE
    normals, radial = vertex_normals(points, tris), (points - [0.1, -0.05, 2.5]) / 0.6
    away = np.abs(np.sum(normals * radial, axis=1))
    assert np.quantile(away, 0.02) > 0.999


def test_a_texture_is_seen_in_perspective() -> None:
    """A floor whose texture is its own x coordinate: the colour at a pixel is the x where its ray meets the floor."""
    points = np.array([[-2.0, 0.6, 1.0], [2.0, 0.6, 1.0], [-2.0, 0.6, 9.0], [2.0, 0.6, 9.0]])
    tris = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    uv = ((points[:, [0, 0]] + 2.0) / 4.0)[tris].astype(np.float32)
    ramp = ((np.arange(256) + 0.5) / 256).astype(np.float32)
    texels, info = np.repeat(ramp[:, None], 3, axis=1), np.array([[0, 256, 1]])
    p = pictured(points)
    index = rasterize(p, tris, *SIZE, 1)[1]
    lit = np.zeros((4, 1))
    lit[:, 0] = 1.0
    none = np.zeros((0, 3))
    light = shade(
        index,
        p,
        points,
        np.tile([0.0, 0.0, 1.0], (4, 1)),
        tris,
        uv,
        np.zeros(2, np.int32),
        texels,
        info,
        np.zeros((1, 2)),
        lit,
        np.zeros(3),
        1,
        False,
        none,
        np.zeros(0),
        1.0,
        1.0,
    )
    seen = index >= 0
    assert seen.sum() > 300
    x = (0.6 * rays()[..., 0][seen] / rays()[..., 1][seen] + 2.0) / 4.0
    np.testing.assert_allclose(light[..., 0][seen], np.clip(x, 0.5 / 256, 1 - 0.5 / 256), atol=2e-6)


def test_soft_coverage_and_the_colour_table() -> None:
    light = np.random.default_rng(1).random((8, 8, 3)).astype(np.float32)
    index = np.where(np.arange(64).reshape(8, 8) % 3, 5, -1).astype(np.int32)
    index[0, :2] = 9
    color, cover, own = averaged(light, index, 7, 2, SRGB)
    blocks = (4, 2, 4, 2)
    np.testing.assert_allclose(cover, (index >= 0).reshape(blocks).mean(axis=(1, 3)))
    np.testing.assert_allclose(own, ((index >= 0) & (index < 7)).reshape(blocks).mean(axis=(1, 3)))
    exact = (encode(light) * (index >= 0)[..., None]).reshape(*blocks, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(color, exact, atol=2e-5)
