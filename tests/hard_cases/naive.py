"""Splatting as the papers write it, and nothing else: the first version anybody would write.
Never used by the product."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Gaussians


class Flat(NamedTuple):
    """N Gaussians on the picture, px."""

    u: torch.Tensor
    v: torch.Tensor
    z: torch.Tensor
    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    det: torch.Tensor


def project(g: Gaussians, camera: Camera, low_pass: float = 0.0) -> Flat:
    """Centres, depths, covariances [[a, b], [b, c]] = J W S W^T J^T and their determinants (Zwicker et al. 2002), in
    the dtype of the Gaussians."""
    k, pose = (torch.as_tensor(np.asarray(m), dtype=g.mean.dtype) for m in (camera.intrinsics, camera.world_to_camera))
    x, y, z = (g.mean @ pose[:3, :3].T + pose[:3, 3]).unbind(1)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([k[0, 0] / z, zero, -k[0, 0] * x / z**2], 1),
            torch.stack([zero, k[1, 1] / z, -k[1, 1] * y / z**2], 1),
        ],
        1,
    )
    axes = g.rotation * g.scale[:, None, :]
    seen = jacobian @ pose[:3, :3]
    covariance = seen @ (axes @ axes.transpose(1, 2)) @ seen.transpose(1, 2)
    a, b, c = covariance[:, 0, 0] + low_pass, covariance[:, 0, 1], covariance[:, 1, 1] + low_pass
    return Flat(k[0, 0] * x / z + k[0, 2], k[1, 1] * y / z + k[1, 2], z, a, b, c, a * c - b * b)


def alphas(
    g: Gaussians, camera: Camera, low_pass: float = 0.0, centre: float = 0.5
) -> tuple[torch.Tensor, torch.Tensor]:
    """Alpha [N, h, w] of each Gaussian at each pixel, o exp(-d^T C^-1 d / 2), and depth [N] (Kerbl et al. 2023)."""
    flat = project(g, camera, low_pass)
    rows, columns = torch.meshgrid(
        torch.arange(camera.height) + centre, torch.arange(camera.width) + centre, indexing="ij"
    )
    u, v, _, a, b, c, det = (t[:, None, None] for t in flat)
    dx, dy = columns - u, rows - v
    exponent = -0.5 * (c / det * dx * dx - 2 * b / det * dx * dy + a / det * dy * dy)
    return g.opacity[:, None, None] * torch.exp(exponent), flat.z


def splat(
    g: Gaussians, camera: Camera, low_pass: float = 0.0, centre: float = 0.5
) -> tuple[torch.Tensor, torch.Tensor]:
    """Colour [h, w, 3], premultiplied, and alpha [h, w]: all Gaussians sorted by depth and blended front to back."""
    alpha, z = alphas(g, camera, low_pass, centre)
    order = torch.argsort(z)
    return blend(alpha[order], g.color[order])


def blend(alpha: torch.Tensor, color: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Colour [h, w, 3] and alpha [h, w] of layers [N, h, w] from front to back with colours [N, 3]."""
    behind = torch.cumprod(1 - alpha, 0)
    weight = alpha * torch.cat([torch.ones_like(behind[:1]), behind[:-1]])
    return torch.einsum("nhw,nc->hwc", weight, color), weight.sum(0)
