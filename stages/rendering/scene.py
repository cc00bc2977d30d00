"""What the rasterizer is given: Gaussians in the world, a camera, and one record of every cut-off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from storage.rig import points_from_integer_centres

PIXEL_CENTRE = float(points_from_integer_centres(np.zeros(())))
"""Coordinate of the centre of pixel 0, px."""


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic Gaussians in world axes, metres. All tensors share one dtype and one device."""

    mean: torch.Tensor  # [N, 3]
    """Centres, world metres."""
    rotation: torch.Tensor  # [N, 3, 3]
    """Columns are the unit axes (tangent, tangent, normal) in the world."""
    scale: torch.Tensor  # [N, 3]
    """Standard deviations along the columns of `rotation`, metres."""
    opacity: torch.Tensor  # [N]
    """Alpha at the centre, 0..1."""
    color: torch.Tensor  # [N, 3]
    """Display-referred sRGB, 0..1, not premultiplied."""

    def __len__(self) -> int:
        return self.mean.shape[0]

    @classmethod
    def concatenate(cls, parts: list[Gaussians]) -> Gaussians:
        """One set from several, in the order given."""
        return cls(*(torch.cat([getattr(p, name) for p in parts]) for name in cls.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Camera:
    """One target camera without distortion."""

    intrinsics: np.ndarray
    """[3, 3] px, our pixel centres."""
    world_to_camera: np.ndarray
    """[4, 4] rigid, metres."""
    width: int
    """px."""
    height: int
    """px."""

    @property
    def centre(self) -> np.ndarray:
        """[3] centre in the world, metres."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]


@dataclass(frozen=True)
class Cutoffs:
    """Every threshold of the rasterizer, once: forward and backward cannot disagree about them."""

    near: float = 0.01
    """A Gaussian whose centre lies at z <= near is culled, metres (gsplat's default)."""
    frustum_margin: float = 0.3
    """The Jacobian is evaluated inside the frustum widened by this share of tan(half field of view) (gsplat, Inria)."""
    low_pass: float = 0.0
    """Variance added to both image axes, px^2. 3DGS uses 0.3; on pixel-sized Gaussians that costs 7-9 dB, so only the effect anti_aliasing adds some."""
    variance_min: float = 1e-10
    """A Gaussian whose projection has det <= variance_min * (a + c), so a smallest variance about this in px^2, is culled."""
    alpha_min: float = 1 / 255
    """A contribution below this alpha is skipped."""
    alpha_max: float = 0.99
    """Alpha is capped here, so that 1 - alpha stays away from zero."""
    transmittance_stop: float = 1e-4
    """The Gaussian that would bring the transmittance to this or below is dropped with all behind it: (1 - alpha_max)^2."""
