"""From pixel-aligned maps of one source view to 3D Gaussians in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from stages.gaussians.frame import tangents
from stages.rendering.scene import Camera, Gaussians
from storage.rig import points_from_integer_centres


@dataclass(frozen=True, eq=False)
class Maps:
    """One frame of one source view, as the archive holds it."""

    color: np.ndarray  # [h, w, 3] uint8
    depth: np.ndarray  # [h, w] float32, metres, 0 = none
    scale: np.ndarray  # [3, h, w] float16, metres
    normal: np.ndarray  # [3, h, w] float16, camera axes
    opacity: np.ndarray  # [2, h, w] float16, face-on and grazing


@dataclass(frozen=True, eq=False)
class Lifted:
    """The Gaussians of one source view: all but the opacity is the same for every target."""

    mean: torch.Tensor  # [N, 3]
    """World metres."""
    rotation: torch.Tensor  # [N, 3, 3]
    """Columns (tangent, tangent, normal), world axes."""
    scale: torch.Tensor  # [N, 3]
    """Metres."""
    faces: torch.Tensor  # [N, 2]
    """Opacity face-on and at grazing angle."""
    color: torch.Tensor  # [N, 3]
    """sRGB 0..1."""

    def seen_from(self, camera: Camera) -> Gaussians:
        """The Gaussians with the opacity they show to a camera.

        opacity = c face_on + (1 - c) grazing, c the cosine between the normal and the ray to the camera's centre. A
        surface turned away from the camera is its inner side: those Gaussians have opacity 0.
        """
        centre = camera.centre.tolist()
        ray = torch.stack([centre[i] - self.mean[:, i] for i in range(3)])  # [3, N]
        length = torch.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2).clamp(min=1e-12)
        n = self.rotation[:, :, 2]
        cosine = (n[:, 0] * ray[0] + n[:, 1] * ray[1] + n[:, 2] * ray[2]) / length
        opacity = cosine * self.faces[:, 0] + (1 - cosine) * self.faces[:, 1]
        return Gaussians(self.mean, self.rotation, self.scale, torch.where(cosine > 0, opacity, 0.0), self.color)


def lift(maps: Maps, intrinsics: np.ndarray, world_to_camera: np.ndarray, dtype: torch.dtype, device: torch.device) -> Lifted:
    """One Gaussian for every pixel that has depth and opacity.

    Position: depth times the ray through the pixel's centre. Orientation: the normal and the tangents that follow from
    it without twist. intrinsics [3, 3] px in our pixel centres; world_to_camera [4, 4]. Pixels that are not finite make
    no Gaussian.
    """
    rows, columns = np.nonzero(np.isfinite(maps.depth) & (maps.depth > 0) & (maps.opacity[0] > 0))
    pick = (slice(None), rows, columns)

    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device, dtype)

    z = maps.depth[rows, columns].astype(np.float64)
    u, v = points_from_integer_centres(np.stack([columns, rows], axis=1)).T
    y = (v - intrinsics[1, 2]) / intrinsics[1, 1]
    x = (u - intrinsics[0, 2] - intrinsics[0, 1] * y) / intrinsics[0, 0]
    normal = maps.normal[pick].astype(np.float64)  # [3, N]
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1), np.array([[0.0], [0.0], [-1.0]]))
    first, second = tangents(*normal)
    axes = [np.stack(a) for a in (first, second, tuple(normal))]  # 3 x [3, N], camera axes
    r, t = world_to_camera[:3, :3], world_to_camera[:3, 3]
    mean = _to_world(r, np.stack([x * z - t[0], y * z - t[1], z - t[2]]))
    rotation = np.stack([_to_world(r, a) for a in axes], axis=2)  # [N, 3 world, 3 axes]
    color = maps.color[rows, columns].astype(np.float64) / 255
    return Lifted(tensor(mean), tensor(rotation), tensor(maps.scale[pick].T), tensor(maps.opacity[pick].T), tensor(color))


def _to_world(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """[N, 3] = R^T v for v [3, N], written out: a matrix product's rounding may depend on the number of threads."""
    return np.stack([rotation[0, i] * vectors[0] + rotation[1, i] * vectors[1] + rotation[2, i] * vectors[2] for i in range(3)], axis=1)
