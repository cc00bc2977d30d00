"""Gaussians into pictures, by one call."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.dags.notebook.arguments import camera_index
from posegaussian.stages.splatting.definition.scene import Camera, Drawing, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.cameras import Rig


def camera_of(rig: Rig, view: str | int, height: int | None = None) -> Camera:
    """A camera of a rig, or the same camera with a picture of another height (px).

    Raises ArchiveError for a name or an index that is none of the rig's; it names those there are.
    """
    index = camera_index(rig.names, view, "the rig")
    width, full = (int(n) for n in rig.size[index])
    if height is None:
        return Camera(rig.intrinsics[index], rig.world_to_camera[index], width, full)
    scale = height / full
    intrinsics = rig.intrinsics[index].copy()
    intrinsics[0] *= round(width * scale) / width
    intrinsics[1] *= scale
    return Camera(intrinsics, rig.world_to_camera[index], round(width * scale), height)


def draw(
    gaussians: Gaussians, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0), drawing: Drawing | None = None
) -> np.ndarray:
    """[h, w, 3] uint8 sRGB picture of Gaussians, as a camera sees them, over a colour (sRGB, 0..1).

    Raises ValueError for what cannot be drawn; it names the argument, its value and what to do.
    """
    behind = np.asarray(background, float)
    if behind.shape != (3,) or not ((behind >= 0) & (behind <= 1)).all():
        raise ValueError(
            f"background {background!r}: it must be three numbers within 0..1, red, green and blue as sRGB; divide"
            " bytes by 255"
        )
    result = rasterize(gaussians, [camera], drawing=drawing)
    color, alpha = result.color[0].detach().cpu().numpy(), result.alpha[0].detach().cpu().numpy()
    over = color + (1 - alpha[..., None]) * behind.astype(color.dtype)
    return np.rint(np.clip(over, 0, 1) * 255).astype(np.uint8)
