"""Lifting: positions at pixel centres, axes in the world, opacity by the angle it is seen at."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.network.model.heads import learned_quaternion, normal_of, twist_of
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import rigid

K = np.array([[60.0, 2.0, 21.0], [0, 55.0, 14.0], [0, 0, 1]])
H, W = 12, 16
CPU = torch.device("cpu")


def maps(
    normal: tuple[float, float, float] = (0.0, 0.0, -1.0), face_on: float = 0.8, grazing: float = 0.2
) -> GaussianMaps:
    depth = np.linspace(1.5, 2.5, H * W, dtype=np.float32).reshape(H, W)
    n = np.broadcast_to(np.array(normal, np.float16)[:, None, None], (3, H, W))
    opacity = np.broadcast_to(np.array([face_on, grazing], np.float16)[:, None, None], (2, H, W)).copy()
    return GaussianMaps(
        np.full((H, W, 3), 51, np.uint8), depth, np.full((3, H, W), 0.01, np.float16), n.copy(), opacity
    )


def pose() -> np.ndarray:
    a = 0.7
    return rigid(
        np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]), np.array([0.3, -0.2, 2.0])
    )


def test_means_project_back_to_pixel_centres_and_depth() -> None:
    m = maps()
    lifted = lift(m, K, pose(), torch.float64, CPU)
    camera_points = lifted.mean.numpy() @ pose()[:3, :3].T + pose()[:3, 3]
    pixels = camera_points @ K.T / camera_points[:, 2:]
    v, u = np.mgrid[0:H, 0:W] + 0.5
    np.testing.assert_allclose(pixels[:, :2], np.stack([u.ravel(), v.ravel()], axis=1), atol=1e-9)
    np.testing.assert_allclose(camera_points[:, 2], m.depth.ravel(), atol=1e-12)
    np.testing.assert_allclose(lifted.color.numpy(), 0.2)


def test_axes_are_rotations_whose_third_is_the_normal() -> None:
    lifted = lift(maps((0.5, -0.3, -0.8)), K, pose(), torch.float64, CPU)
    r = lifted.rotation.numpy()
    np.testing.assert_allclose(r.transpose(0, 2, 1) @ r, np.broadcast_to(np.eye(3), r.shape), atol=1e-12)
    n = np.array([0.5, -0.3, -0.8], np.float16).astype(float)
    np.testing.assert_allclose(r[0, :, 2], pose()[:3, :3].T @ (n / np.linalg.norm(n)), atol=1e-12)


def test_normal_and_twist_of_a_quaternion_are_its_rotation() -> None:
    """Whatever the turn about the normal, half a turn too; float16 maps hold it to a thousandth."""
    random = torch.Generator().manual_seed(3)
    normal = torch.tensor([0.3, -0.4, -0.866]).repeat(1, 1).T[None, :, :, None].expand(1, 3, H, W)
    x = torch.cat([torch.zeros(1, 3, H, W), 9 * torch.randn(1, 1, H, W, generator=random)], dim=1)
    tilt = torch.cat([torch.zeros(1, 1, H, W), torch.randn(1, 2, H, W, generator=random), 0 * x[:, :1]], dim=1)
    q = learned_quaternion(x + tilt, normal / normal.norm(dim=1, keepdim=True)).double()
    m = replace(
        maps(), normal=normal_of(q)[0].numpy().astype(np.float16), twist=twist_of(q)[0].numpy().astype(np.float16)
    )
    w, i, j, k = q[0].permute(1, 2, 0).reshape(-1, 4).unbind(dim=1)
    rows = [
        [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
        [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
        [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
    ]
    whole = torch.stack([torch.stack(r, dim=1) for r in rows], dim=1)
    lifted = lift(m, K, np.eye(4), torch.float64, CPU).rotation
    usable = lifted[:, 2, 2] < 0.5  # beyond, the tangents that follow from a normal turn quickly
    assert usable.float().mean() > 0.8
    np.testing.assert_allclose(lifted[usable], whole[usable], atol=4e-3)
    assert (m.twist[0] < -0.5).any(), "some turn by more than a right angle"


def test_no_twist_is_the_frame_that_follows_from_the_normal() -> None:
    m = maps((0.5, -0.3, -0.8))
    flat = lift(m, K, pose(), torch.float32, CPU).rotation
    for turn in ((1.0, 0.0), (0.0, 0.0)):  # none, and one without a length
        twist = np.broadcast_to(np.array(turn, np.float16)[:, None, None], (2, H, W))
        assert torch.equal(lift(replace(m, twist=twist), K, pose(), torch.float32, CPU).rotation, flat)


def test_only_pixels_with_depth_and_opacity_become_gaussians() -> None:
    m = maps()
    m.depth[0, 0], m.depth[0, 1], m.opacity[:, 0, 2] = 0, np.nan, 0
    assert len(lift(m, K, pose(), torch.float32, CPU).mean) == H * W - 3


@pytest.mark.parametrize(("degrees", "expected"), [(0, 0.8), (60, 0.5), (89.9, 0.2), (100, 0.0), (180, 0.0)])
def test_opacity_between_face_on_and_grazing(degrees: float, expected: float) -> None:
    """Linear in the cosine; the inner side of a surface is not there."""
    m = maps()
    m.depth[:] = 0
    m.depth[6, 8] = 2.0
    lifted = lift(m, K, np.eye(4), torch.float64, CPU)
    a = np.radians(degrees)
    target = np.eye(4)
    target[:3, 3] = -(lifted.mean[0].numpy() + 3 * np.array([np.sin(a), 0, -np.cos(a)]))
    opacity = lifted.seen_from(Camera(K, target, W, H)).opacity
    np.testing.assert_allclose(opacity.numpy(), expected, atol=2e-3)  # float16 maps


def test_a_list_is_lifted_as_its_maps_are_and_is_spread_to_what_they_have_where_there_is_a_gaussian() -> None:
    """Bit by bit; what has neither depth nor opacity is in no list."""
    random = np.random.default_rng(5)
    some = random.uniform(size=(H, W)) < 0.4
    m = maps((0.1, 0.2, -0.9))
    scale, opacity = (np.where(random.uniform(size=(H, W)) < 0.5, a, a / 2) for a in (m.scale, m.opacity))
    full = replace(
        m,
        color=random.integers(0, 256, (H, W, 3)).astype(np.uint8),
        scale=scale,
        opacity=np.where(some, opacity, 0),
        twist=random.normal(size=(2, H, W)).astype(np.float16),
    )
    listed = full.listed()
    assert np.shape(listed.depth) == (1, some.sum())
    for ours, theirs in zip(
        vars(lift(listed, K, pose(), torch.float32, CPU)).values(),
        vars(lift(full, K, pose(), torch.float32, CPU)).values(),
        strict=True,
    ):
        assert np.array_equal(ours, theirs)
    again = listed.spread(H)
    for name in ("depth", "scale", "normal", "opacity", "twist"):
        np.testing.assert_array_equal(getattr(again, name), np.where(some, getattr(full, name), 0))
    np.testing.assert_array_equal(again.color, np.where(some[..., None], full.color, 0))
