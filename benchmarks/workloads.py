"""Scenes for the renderer's benchmark: a person lifted from two source views, random blobs, a captured guitar."""

from __future__ import annotations

import numpy as np
import torch

from stages.capture.motion import pose
from stages.capture.person import look_at, render
from stages.gaussians.prior import normals, scales
from stages.rendering.lift import Maps, lift
from stages.rendering.scene import Camera, Gaussians

SOURCE = 512
"""Side of the person's source pictures, px."""
ZOOM = 1.9
"""Focal length over picture width: the body fills 27 % of a source picture."""
DISTANCE = 2.4
"""From the cameras to the body's axis, m."""


def _camera(degrees: float, size: int) -> Camera:
    a = np.radians(degrees)
    centre = np.array([DISTANCE * np.cos(a), DISTANCE * np.sin(a), 1.2])
    k = np.array([[ZOOM * size, 0.0, size / 2], [0.0, ZOOM * size, size / 2], [0.0, 0.0, 1.0]])
    return Camera(k, look_at(centre, np.array([0.0, 0.0, 1.15])), size, size)


def person(size: int) -> tuple[Gaussians, Camera]:
    """About 145,000 pixel-aligned Gaussians of two source views 45 degrees apart, seen from the middle; sigma 0.6-1.2 px at 512."""
    target, parts = _camera(0.0, size), []
    for degrees in (-22.5, 22.5):
        source = _camera(degrees, SOURCE)
        color, mask, depth = render(pose("wave", 0.2), source.intrinsics, source.world_to_camera, (SOURCE, SOURCE), 2)
        normal = normals(depth, source.intrinsics)
        scale = scales(depth, normal, source.intrinsics, 0.9, 0.1, 0.5)
        face_on = np.where(depth > 0, 0.99 * mask / np.float32(255), 0)
        maps = Maps(color, depth, scale, normal, np.stack([face_on, 0.8 * face_on]))
        parts.append(lift(maps, source.intrinsics, source.world_to_camera, torch.float32, torch.device("cpu")).seen_from(target))
    return Gaussians.concatenate(parts), target
