"""The analytic prior of one picture: normals and sizes of Gaussians from a depth map. numpy, float32, camera axes."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.tangent_frame import tangents

JUMP = 8.0
"""A depth step of more than this many pixel footprints z/f between neighbours is a silhouette,
not a slope (83 degrees)."""


def rays(intrinsics: np.ndarray, height: int, width: int) -> np.ndarray:
    """[3, h, w] float32 (x/z, y/z, 1) through the pixel centres, camera axes."""
    u, v = np.moveaxis(pixel_centres((width, height)), -1, 0)
    y = (v - intrinsics[1, 2]) / intrinsics[1, 1]
    x = (u - intrinsics[0, 2] - intrinsics[0, 1] * y) / intrinsics[0, 0]
    return np.stack([x, y, np.ones_like(x)]).astype(np.float32)


def depth_slope(depth: np.ndarray, axis: int, footprint: np.ndarray) -> np.ndarray:
    """[h, w] dz per pixel along an axis, from the one-sided differences that do not cross a depth jump.

    Args:
        depth: [h, w] metres, 0 = no surface.
        axis: 0 down, 1 right.
        footprint: [h, w] z/f, the size of a pixel at that depth, metres.

    Both sides usable: their mean (the central difference). One: that one. None (an isolated pixel): 0.
    """
    step = np.diff(depth, axis=axis)
    first, last = [slice(None)] * 2, [slice(None)] * 2
    first[axis], last[axis] = slice(None, -1), slice(1, None)
    near, far = tuple(first), tuple(last)
    usable = (depth[near] > 0) & (depth[far] > 0) & (np.abs(step) <= JUMP * np.minimum(footprint[near], footprint[far]))
    step = np.where(usable, step, 0)
    total, count = np.zeros_like(depth), np.zeros(depth.shape, np.float32)
    for side in (near, far):
        total[side] += step
        count[side] += usable
    return total / np.maximum(count, 1)


def normals(depth: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """[3, h, w] float32 unit normals in camera axes, facing the camera; 0 where there is no surface.

    n is the cross product of the surface's derivatives X_u = z r_u + r dz/du and X_v, X = z r, r the ray of the pixel.
    """
    height, width = depth.shape
    r = rays(intrinsics, height, width)
    z = depth.astype(np.float32)
    x_u = r * depth_slope(z, 1, z / np.float32(intrinsics[0, 0]))
    x_v = r * depth_slope(z, 0, z / np.float32(intrinsics[1, 1]))
    r_u, r_v = ray_derivatives(intrinsics)
    x_u += r_u[:, None, None] * z
    x_v += r_v[:, None, None] * z
    n = np.stack(
        [x_v[1] * x_u[2] - x_v[2] * x_u[1], x_v[2] * x_u[0] - x_v[0] * x_u[2], x_v[0] * x_u[1] - x_v[1] * x_u[0]]
    )
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    return n / np.where(length > 0, length, 1)


def ray_derivatives(intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[3], [3] float32: how the ray changes per pixel to the right and per pixel down."""
    fx, fy, skew = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 1]
    return np.array([1 / fx, 0, 0], np.float32), np.array([-skew / (fx * fy), 1 / fy, 0], np.float32)


def scales(
    depth: np.ndarray, normal: np.ndarray, intrinsics: np.ndarray, footprint: float, thickness: float, cosine_min: float
) -> np.ndarray:
    """[3, h, w] float32 standard deviations along (tangent, tangent, normal), metres; 0 where there is no surface.

    One pixel covers, on the tangent plane, the parallelogram X_u, X_v with X_u = z (r_u - r (n.r_u) / (n.r)): z/f
    across the slope and z / (f cos) along it. A Gaussian of covariance footprint^2 (X_u X_u^T + X_v X_v^T) would cover
    it exactly, but the tangent frame may not twist towards the slope; so the diagonal of that covariance in the frame
    is
    kept: exact for slopes along the picture's axes (limbs hang and stretch along them), and round with the same total
    variance at 45 degrees, where a disc is too wide across by at most what it lacks along.

    `cosine_min` bounds the stretch: surfaces seen at a flatter angle are sized as if seen at that one.
    """
    height, width = depth.shape
    r = rays(intrinsics, height, width)
    length = np.sqrt(r[0] ** 2 + r[1] ** 2 + 1)
    facing = np.minimum(normal[0] * r[0] + normal[1] * r[1] + normal[2], -cosine_min * length)
    first, second = tangents(normal[0], normal[1], normal[2])
    variance = np.zeros((2, height, width), np.float32)
    for d in ray_derivatives(intrinsics):
        slide = (normal[0] * d[0] + normal[1] * d[1]) / facing
        x = [d[i] - r[i] * slide for i in range(3)]
        for j, t in enumerate((first, second)):
            variance[j] += (t[0] * x[0] + t[1] * x[1] + t[2] * x[2]) ** 2
    pixel = 2 / (intrinsics[0, 0] + intrinsics[1, 1])
    across = np.full((1, height, width), thickness * pixel, np.float32)
    return np.concatenate([np.sqrt(variance), across]) * np.float32(footprint) * depth.astype(np.float32)
