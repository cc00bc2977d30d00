"""World points to pixels and back, for pinhole cameras without distortion."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.cameras import camera_centre, points_from_integer_centres


def pixel_centres(size: tuple[int, int]) -> np.ndarray:
    """[h, w, 2] (u, v) of the centre of every pixel of a picture of `size` (width, height), px."""
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    return points_from_integer_centres(np.stack([columns, rows], axis=-1))


def project(points: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World points -> pixels [..., 2] (u, v) and depth [...] along the optical axis, metres.

    `points` is [..., 3] in world metres, `intrinsics` [3, 3] px, `world_to_camera` [4, 4]. A point in the camera's
    plane (depth 0) has no picture: its pixel is infinite or undefined, and a point behind it is mirrored; callers
    look at the sign of the depth. Not checked: that the intrinsics are upper triangular.
    """
    camera = np.asarray(points, dtype=np.float64) @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    depth = camera[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = camera @ intrinsics[:2].T / depth[..., None]
    return pixels, depth


def rays(pixels: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays through pixels [..., 2]: the camera's centre [3] and directions [..., 3], both in the world.

    A direction advances one metre along the optical axis, so that `centre + depth * direction` is the point of that
    depth.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    return camera_centre(world_to_camera), homogeneous @ np.linalg.inv(intrinsics).T @ world_to_camera[:3, :3]


def unproject(depth: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> np.ndarray:
    """Depth map [h, w], metres along the optical axis at the pixel centres -> world points [h, w, 3], float64.

    A pixel without surface (depth 0) becomes the camera's centre; callers mask it.
    """
    h, w = depth.shape
    centre, directions = rays(pixel_centres((w, h)), intrinsics, world_to_camera)
    return centre + directions * np.asarray(depth, dtype=np.float64)[..., None]
