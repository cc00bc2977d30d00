"""EWA projection of 3D Gaussians: Zwicker et al., "EWA splatting", 2002, in the form of 3D Gaussian splatting.

The 2D covariance is M M^T with M = J W R S, [2, 3]. Its determinant is the squared length of the cross product of
M's rows, which neither cancels nor turns negative for needles, and the exponent is a sum of two squares, so that no
alpha can exceed its opacity whatever the rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from posegaussian.storage.model.cameras import PIXEL_CENTRE


@dataclass(frozen=True, eq=False)
class Projected:
    """The K Gaussians that can reach the picture, in the order of the input."""

    mean: torch.Tensor  # [K, 2]
    """Centres, px, our pixel centres."""
    whitening: torch.Tensor  # [K, 4]
    """Rows (p0, p1), (q0, q1): exponent(d) = ((p0 dx + p1 dy)^2 + (q0 dx + q1 dy)^2) / 2."""
    extent: torch.Tensor  # [K, 2]
    """Half width and height of the box outside which alpha < alpha_min, px; carries no gradient."""
    depth: torch.Tensor  # [K]
    """Distance along the optical axis, metres."""
    opacity: torch.Tensor  # [K]
    """Alpha at the centre, after compensation."""
    color: torch.Tensor  # [K, 3]
    """As in the input."""
    normal: torch.Tensor  # [K, 3]
    """Third axis in camera axes, turned towards the camera."""
    index: torch.Tensor  # [K]
    """Which of the input's they are."""
    masked: int
    """Gaussians left out because an input or their projection was not finite."""


def finite_rows(g: Gaussians) -> torch.Tensor:
    """[N] bool: every attribute of the Gaussian is a finite number."""
    parts = (g.mean, g.rotation.flatten(1), g.scale, g.opacity[:, None], g.color)
    return torch.isfinite(torch.cat(parts, dim=1)).all(dim=1)


def _rows(g: Gaussians, index: torch.Tensor) -> Gaussians:
    """Selected, not indexed: backward then adds rows where an indexing would sort them first, on a GPU."""
    return Gaussians(*(values.index_select(0, index) for values in (g.mean, g.rotation, g.scale, g.opacity, g.color)))


def project(gaussians: Gaussians, camera: Camera, cutoffs: Cutoffs) -> Projected:
    """Project, cull and bound Gaussians; differentiable in every attribute of those that are kept.

    Culled: z <= near, opacity < alpha_min, a projection thinner than `variance_min`, a box that holds no pixel centre.
    Masked and counted: anything not finite, in the input or in its projection. What is left out is found without
    gradients and taken away before the arithmetic that has them, so that no NaN enters one.
    """
    with torch.no_grad():
        finite = torch.nonzero(finite_rows(gaussians))[:, 0]
        g = _rows(gaussians, finite)
        front = (_camera_axis(g.mean, camera, 2) > cutoffs.near) & (g.opacity >= cutoffs.alpha_min)
        index = finite[front]
        g = _rows(gaussians, index)
        s = _on_screen(g, camera, cutoffs)
        thick = s.det > cutoffs.variance_min * (s.a + s.c)
        opacity = _shown(g.opacity, s, cutoffs)
        reach = 2 * torch.log((opacity / cutoffs.alpha_min).clamp(min=1.0))
        # float32 rounding at 8k px
        extent = torch.stack([torch.sqrt(reach * s.a), torch.sqrt(reach * s.c)], dim=1) + 0.01
        sane = (
            torch.isfinite(s.det)
            & torch.isfinite(s.u)
            & torch.isfinite(s.v)
            & torch.isfinite(s.a)
            & torch.isfinite(s.c)
        )
        keep = sane & thick & (opacity >= cutoffs.alpha_min)
        keep &= (s.u + extent[:, 0] >= PIXEL_CENTRE) & (s.u - extent[:, 0] <= camera.width - 1 + PIXEL_CENTRE)
        keep &= (s.v + extent[:, 1] >= PIXEL_CENTRE) & (s.v - extent[:, 1] <= camera.height - 1 + PIXEL_CENTRE)
        masked = len(gaussians) - len(finite) + int((~sane).sum())
    index = index[keep]
    g = _rows(gaussians, index)
    s = _on_screen(g, camera, cutoffs)
    opacity = _shown(g.opacity, s, cutoffs)
    return Projected(
        torch.stack([s.u, s.v], dim=1),
        _whitening(s.a, s.b, s.c, s.det),
        extent[keep],
        s.z,
        opacity,
        g.color,
        _normal(g, camera),
        index,
        masked,
    )


def _shown(opacity: torch.Tensor, s: _Screen, cutoffs: Cutoffs) -> torch.Tensor:
    """[N] opacity times sqrt(det / det with the low pass), bounded below, where that is asked for."""
    return (
        opacity * torch.sqrt((s.sharp / s.det).clamp(min=cutoffs.compensation_min**2))
        if cutoffs.compensation
        else opacity
    )


def _normal(g: Gaussians, camera: Camera) -> torch.Tensor:
    """[N, 3] third axes in camera axes, turned towards the camera."""
    w = _pose(camera, g.mean)
    n = torch.stack(
        [
            w[i, 0] * g.rotation[:, 0, 2] + w[i, 1] * g.rotation[:, 1, 2] + w[i, 2] * g.rotation[:, 2, 2]
            for i in range(3)
        ],
        dim=1,
    )
    away = _dot(n, torch.stack([_camera_axis(g.mean, camera, i) for i in range(3)], dim=1)).detach() > 0
    return torch.where(away[:, None], -n, n)


class _Screen(NamedTuple):
    """Centres u, v px, depth z m, covariance [[a, b], [b, c]] px^2,
    its determinant and that before the low pass, each [N]."""

    u: torch.Tensor
    v: torch.Tensor
    z: torch.Tensor
    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    det: torch.Tensor
    sharp: torch.Tensor


def _on_screen(g: Gaussians, camera: Camera, cutoffs: Cutoffs) -> _Screen:
    x, y, z = (_camera_axis(g.mean, camera, i) for i in range(3))
    k = _tensor(camera.intrinsics, g.mean)
    u = k[0, 0] * (x / z) + k[0, 1] * (y / z) + k[0, 2]
    v = k[1, 1] * (y / z) + k[1, 2]
    m0, m1 = _jacobian_rows(g, camera, cutoffs, x / z, y / z, z)
    a, b, c = _dot(m0, m0), _dot(m0, m1), _dot(m1, m1)
    n = torch.linalg.cross(m0, m1)
    sharp = _dot(n, n)
    det = sharp + cutoffs.low_pass * (a + c) + cutoffs.low_pass**2
    return _Screen(u, v, z, a + cutoffs.low_pass, b, c + cutoffs.low_pass, det, sharp)


def _tensor(values: np.ndarray | torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(values, dtype=like.dtype, device=like.device)


def _pose(camera: Camera, like: torch.Tensor) -> torch.Tensor:
    return _tensor(camera.world_to_camera, like)


def _camera_axis(mean: torch.Tensor, camera: Camera, i: int) -> torch.Tensor:
    """[N] one camera coordinate, written out: no matrix product whose summation order depends on threads."""
    r = _pose(camera, mean)[i]
    return r[0] * mean[:, 0] + r[1] * mean[:, 1] + r[2] * mean[:, 2] + r[3]


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _jacobian_rows(
    g: Gaussians, camera: Camera, cutoffs: Cutoffs, xz: torch.Tensor, yz: torch.Tensor, z: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rows [N, 3] of M = J W R S, px. The affine approximation is taken inside the widened frustum:
    limits from cx, cy."""
    k = _tensor(camera.intrinsics, g.mean)
    known = torch.as_tensor(camera.intrinsics, dtype=g.mean.dtype).detach()  # where it is: no device is waited for
    fx, cx, fy, cy = (float(known[i]) for i in ((0, 0), (0, 2), (1, 1), (1, 2)))  # the limits carry no gradient
    margin_x, margin_y = (
        cutoffs.frustum_margin * 0.5 * camera.width / fx,
        cutoffs.frustum_margin * 0.5 * camera.height / fy,
    )
    xz = xz.clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    yz = yz.clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    axes = g.rotation * g.scale[:, None, :]  # [N, 3 world, 3 axes]
    w = _pose(camera, g.mean)
    b = [w[i, 0] * axes[:, 0] + w[i, 1] * axes[:, 1] + w[i, 2] * axes[:, 2] for i in range(3)]  # 3 x [N, 3 axes]
    dx = (b[0] - xz[:, None] * b[2]) / z[:, None]
    dy = (b[1] - yz[:, None] * b[2]) / z[:, None]
    return k[0, 0] * dx + k[0, 1] * dy, k[1, 1] * dy


def _whitening(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor, det: torch.Tensor) -> torch.Tensor:
    """[K, 4] square root of the conic of [[a, b], [b, c]], completing the square on the larger diagonal entry."""
    wide = a.detach() >= c.detach()
    pivot = torch.where(wide, a, c)
    first, slope = 1 / torch.sqrt(pivot), b / pivot
    second = torch.sqrt(pivot / det)
    zero = torch.zeros_like(first)
    return torch.stack(
        [
            torch.where(wide, first, zero),
            torch.where(wide, zero, first),
            torch.where(wide, -slope * second, second),
            torch.where(wide, second, -slope * second),
        ],
        dim=1,
    )
