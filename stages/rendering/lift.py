"""From pixel-aligned maps of one source view to 3D Gaussians in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch

from stages.gaussians.frame import tangents
from stages.rendering.scene import Camera, Gaussians
from storage.rig import points_from_integer_centres

Values: TypeAlias = np.ndarray | torch.Tensor


@dataclass(frozen=True, eq=False)
class Maps:
    """One frame of one source view: arrays as the archive holds them, or tensors, whose gradients are kept."""

    color: Values  # [h, w, 3] uint8, or a tensor of sRGB 0..1
    depth: Values  # [h, w] float32, metres, 0 = none
    scale: Values  # [3, h, w] float16, metres
    normal: Values  # [3, h, w] float16, camera axes
    opacity: Values  # [2, h, w] float16, face-on and grazing


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
    masked: int = 0
    """Pixels left out because their depth or opacity was not a finite number."""

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
    """One Gaussian for every pixel that has depth and opacity, differentiable in the maps.

    Position: depth times the ray through the pixel's centre. Orientation: the normal and the tangents that follow from
    it without twist. intrinsics [3, 3] px in our pixel centres; world_to_camera [4, 4]. Pixels whose depth is not finite, or
    whose opacity is no number, make no Gaussian and are counted; the rasterizer masks what else is not finite. Nothing but sums, products, quotients and square roots of
    single elements is taken, so the result does not depend on the number of threads.
    """
    depth, opacity = (torch.as_tensor(v).to(device, dtype) for v in (maps.depth, maps.opacity))
    usable = torch.isfinite(depth) & (depth > 0) & (opacity[0] > 0)
    masked = int((~usable & ~(depth <= 0) & ~(opacity[0] <= 0)).sum())
    rows, columns = torch.nonzero(usable, as_tuple=True)

    def at(values: Values) -> tuple[torch.Tensor, ...]:
        return tuple(torch.as_tensor(values).to(device)[:, rows, columns].to(dtype))

    z, k = depth[rows, columns], intrinsics.tolist()
    centre = float(points_from_integer_centres(np.zeros(())))
    y = (rows.to(dtype) + (centre - k[1][2])) / k[1][1]
    x = (columns.to(dtype) + (centre - k[0][2]) - k[0][1] * y) / k[0][0]
    normal = _unit(*at(maps.normal))
    pose = world_to_camera.tolist()
    mean = _to_world(pose, (x * z - pose[0][3], y * z - pose[1][3], z - pose[2][3]))
    rotation = torch.stack([_to_world(pose, axis) for axis in (*tangents(*normal), normal)], dim=2)  # [N, 3 world, 3 axes]
    color = torch.as_tensor(maps.color).to(device)[rows, columns]
    color = color.to(dtype) / 255 if color.dtype == torch.uint8 else color.to(dtype)
    return Lifted(mean, rotation, torch.stack(at(maps.scale), dim=1), torch.stack((opacity[0, rows, columns], opacity[1, rows, columns]), dim=1), color, masked)


def _unit(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The normal at unit length; one without a length faces the camera, and gets no gradient."""
    squared = x * x + y * y + z * z
    flat = squared == 0
    length = torch.sqrt(torch.where(flat, 1.0, squared))
    return x / length, y / length, torch.where(flat, -1.0, z / length)


def _to_world(pose: list[list[float]], vector: Sequence[torch.Tensor]) -> torch.Tensor:
    """[N, 3] = R^T v for v 3 x [N], written out: a matrix product's rounding may depend on the number of threads."""
    return torch.stack([pose[0][i] * vector[0] + pose[1][i] * vector[1] + pose[2][i] * vector[2] for i in range(3)], dim=1)
