"""3D Gaussian splatting frame by frame: fitted to a frame's own source pictures, then drawn into every target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from posegaussian.stages.geometry.projection import unproject
from posegaussian.stages.peers.free_gaussians import FreeGaussians, optimise, start
from posegaussian.stages.peers.ibr import Photo
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.masks import foreground


def fitted(photos: Sequence[Photo], steps: int) -> FreeGaussians | None:
    """Gaussians of one frame after so many steps of one picture each; None where no view has depth to start from."""
    points, colors = [], []
    for photo in photos:
        surface = (photo.depth > 0) & foreground(photo.mask)
        pose, k = np.asarray(photo.camera.world_to_camera), np.asarray(photo.camera.intrinsics)
        points.append(unproject(photo.depth, k, pose)[surface])
        colors.append(photo.color[surface] / 255)
    if sum(map(len, points)) < 4:  # a width takes three neighbours
        return None
    centres = np.stack([photo.camera.centre for photo in photos])
    gaussians = start(np.concatenate(points), np.concatenate(colors), centres)
    for _ in optimise(gaussians, [_filmed(photo) for photo in photos], lambda step: step / steps):
        pass
    return gaussians


def drawn(gaussians: FreeGaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colour [h, w, 3] sRGB 0..1, premultiplied on black, and alpha [h, w], as 3DGS draws them: no retouches."""
    with torch.no_grad():
        picture = gaussians.draw(camera)
    return picture.color[0].numpy(), picture.alpha[0].numpy()


def _filmed(photo: Photo) -> Filmed:
    cover = photo.mask.astype(np.float32) / 255
    color = photo.color.astype(np.float32) / 255 * cover[..., None]
    return Filmed(photo.camera, color, cover)
