"""Laws of the analytic prior: exact on planes, close on spheres, safe at silhouettes."""

import numpy as np
import pytest
import torch

from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.prior import normals, rays, scales
from posegaussian.stages.gaussians.run import prior
from posegaussian.stages.geometry.tangent_frame import tangents
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.projection import project
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs

K = np.array([[60.0, 0, 21.0], [0, 55.0, 14.0], [0, 0, 1]])
H, W = 30, 40


def plane(normal: np.ndarray, distance: float) -> np.ndarray:
    """[H, W] depth of the plane n.X = -distance, seen by a camera with K."""
    r = rays(K, H, W).astype(np.float64)
    return (-distance / np.tensordot(normal, r, 1)).astype(np.float32)


def unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


@pytest.mark.parametrize("normal", [unit(0, 0, -1), unit(0.5, 0, -1), unit(-0.4, 0.7, -1), unit(1.5, 0.3, -1)])
def test_normals_of_a_plane(normal: np.ndarray) -> None:
    n = normals(plane(normal, 2.0), K)
    inner = n[:, 1:-1, 1:-1]
    # depth is no linear function of the pixel on a slanted plane; central differences are off by second order
    assert np.abs(inner - normal[:, None, None]).max() < 0.02
    np.testing.assert_allclose(np.sqrt((n**2).sum(axis=0)), 1, atol=1e-5)
    assert ((n * rays(K, H, W)).sum(axis=0) < 0).all()


def test_normals_do_not_reach_across_a_silhouette() -> None:
    """A tilted near plane before a tilted far one: each side keeps its own normal up to the edge."""
    near, far = unit(0.3, 0.1, -1), unit(-0.3, 0, -1)
    depth = plane(far, 6.0)
    depth[:, : W // 2] = plane(near, 2.0)[:, : W // 2]
    n = normals(depth, K)
    assert np.abs(n[:, 1:-1, 1 : W // 2] - near[:, None, None]).max() < 0.03
    assert np.abs(n[:, 1:-1, W // 2 : -1] - far[:, None, None]).max() < 0.03


def test_an_isolated_pixel_lies_parallel_to_the_picture() -> None:
    depth = np.zeros((H, W), np.float32)
    depth[3, 5] = 2.0
    n = normals(depth, K)
    np.testing.assert_allclose(n[:, 3, 5], [0, 0, -1], atol=1e-6)
    assert not n[:, depth == 0].any()


def test_tangents_are_orthonormal_right_handed_and_do_not_twist() -> None:
    rng = np.random.default_rng(0)
    n = rng.normal(size=(3, 500))
    n[2] = -np.abs(n[2])
    n /= np.linalg.norm(n, axis=0)
    first, second = (np.stack(t) for t in tangents(*n))
    frame = np.stack([first, second, n], axis=-1).transpose(1, 0, 2)
    np.testing.assert_allclose(frame.transpose(0, 2, 1) @ frame, np.broadcast_to(np.eye(3), (500, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1, atol=1e-12)
    # no twist: the axis of the rotation that takes (x, -y, -z) to the frame lies in the picture plane
    turn = frame @ np.diag([1.0, -1, -1]).T
    np.testing.assert_allclose(turn[:, 1, 0] - turn[:, 0, 1], 0, atol=1e-12)


@pytest.mark.parametrize("normal", [unit(0, 0, -1), unit(0.8, 0, -1), unit(0, -0.8, -1)])
def test_a_gaussian_covers_its_own_pixel(normal: np.ndarray) -> None:
    """Slopes along the picture's axes: seen from its own camera the Gaussian is round, `footprint` px wide."""

    k = np.array([[300.0, 0, 21.0], [0, 280.0, 14.0], [0, 0, 1]])
    depth = (-2.0 / np.tensordot(normal, rays(k, H, W).astype(np.float64), 1)).astype(np.float32)
    n = np.broadcast_to(normal[:, None, None], (3, H, W)).astype(np.float32)
    s = scales(depth, n, k, 0.5, 0.1, 0.1)
    lifted = lift(
        GaussianMaps(np.full((H, W, 3), 99, np.uint8), depth, s, n, np.full((2, H, W), 0.9)),
        k,
        np.eye(4),
        torch.float64,
        torch.device("cpu"),
    )
    camera = Camera(k, np.eye(4), W, H)
    p = project(lifted.seen_from(camera), camera, Cutoffs())
    assert len(p.depth) == H * W
    w = p.whitening.numpy().reshape(-1, 2, 2)
    covariance = np.linalg.inv(w.transpose(0, 2, 1) @ w)
    across = np.sqrt(covariance[:, [0, 1], [0, 1]])
    # exact in the middle of the picture;
    # the frame leans against the slope by the ray's few degrees aside, and the thickness adds
    np.testing.assert_allclose(across, 0.5, rtol=0.03)
    np.testing.assert_allclose(p.mean.numpy().reshape(H, W, 2)[3, 7], [7.5, 3.5], atol=1e-5)


def test_total_variance_does_not_depend_on_the_direction_of_the_slope() -> None:
    k = np.array([[60.0, 0, 20.5], [0, 60.0, 15.5], [0, 0, 1]])
    pixel = (slice(None), 15, 20)
    sums = []
    for angle in np.radians([0, 20, 45, 70, 90]):
        n = unit(0.8 * np.cos(angle), 0.8 * np.sin(angle), -1)
        s = scales(
            np.full((H, W), 2.0, np.float32),
            np.broadcast_to(n[:, None, None], (3, H, W)).astype(np.float32),
            k,
            0.5,
            0.1,
            0.1,
        )[pixel]
        sums.append(s[0] ** 2 + s[1] ** 2)
        assert s[2] == pytest.approx(0.1 * 0.5 * 2 / 60)
    np.testing.assert_allclose(sums, (0.5 * 2 / 60) ** 2 * (1 + 1 + 0.64), rtol=1e-4)


def test_stretch_is_bounded_where_the_surface_is_seen_edge_on() -> None:
    n = np.broadcast_to(unit(1, 0, -1e-4)[:, None, None], (3, H, W)).astype(np.float32)
    s = scales(np.full((H, W), 2.0, np.float32), n, K, 0.5, 0.1, 0.4)
    assert np.isfinite(s).all()
    assert s.max() < 0.5 * 2 / 55 / 0.4 * 2


def test_what_is_no_surface_is_zero_in_every_map() -> None:
    depth = plane(unit(0.2, 0, -1), 2.0)
    confidence = np.ones((H, W), np.float16)
    depth[0, 0], depth[0, 1], depth[0, 2], depth[0, 3] = np.nan, np.inf, -1.0, 0.0
    confidence[1, 0], confidence[1, 1], confidence[1, 2] = 0.0, np.nan, 0.01
    maps = prior(depth, confidence, np.full((H, W), 255, np.uint8), K, GaussiansParams())
    for m in maps:
        assert np.isfinite(m).all()
        assert not m[:, 0, :4].any()
        assert not m[:, 1, :3].any()
        assert m[0, 5, 5] != 0


def test_opacity_follows_confidence_and_coverage() -> None:
    depth, confidence = np.full((H, W), 2.0, np.float32), np.linspace(0, 1, H * W).reshape(H, W)
    for mask in (255, 51):
        opacity = prior(
            depth,
            confidence,
            np.full((H, W), mask, np.uint8),
            K,
            GaussiansParams(opacity=0.9, grazing=0.5, confidence_power=0.5, confidence_min=0.0),
        )[2]
        np.testing.assert_allclose(opacity[0], 0.9 * np.sqrt(confidence) * mask / 255, atol=1e-6)
        np.testing.assert_allclose(opacity[1], 0.45 * np.sqrt(confidence) * mask / 255, atol=1e-6)
    ignoring = prior(
        depth,
        confidence,
        np.full((H, W), 255, np.uint8),
        K,
        GaussiansParams(opacity=0.9, confidence_power=0.0, confidence_min=0.0),
    )[2]
    assert (ignoring[0] == np.where(confidence > 0, np.float32(0.9), 0)).all()
