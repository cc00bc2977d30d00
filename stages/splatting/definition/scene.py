"""What the rasterizer is given: Gaussians in the world, a camera, and one record of every cut-off."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import torch

from posegaussian.storage.model.cameras import camera_centre


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

    def to(self, device: torch.device) -> Gaussians:
        """The same on a device, differentiable; those that lie there already are not copied."""
        return Gaussians(*(getattr(self, name).to(device) for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Camera:
    """One target camera without distortion."""

    intrinsics: np.ndarray | torch.Tensor
    """[3, 3] px, our pixel centres; a tensor where its gradient is wanted."""
    world_to_camera: np.ndarray | torch.Tensor
    """[4, 4] rigid, metres; a tensor where its gradient is wanted."""
    width: int
    """px."""
    height: int
    """px."""

    @property
    def centre(self) -> np.ndarray:
        """[3] centre in the world, metres."""
        pose = np.asarray(
            self.world_to_camera.detach().cpu()
            if isinstance(self.world_to_camera, torch.Tensor)
            else self.world_to_camera
        )
        return camera_centre(pose)


@dataclass(frozen=True)
class Cutoffs:
    """Every threshold of the rasterizer, once: forward and backward cannot disagree about them."""

    near: float = 0.01
    """A Gaussian whose centre lies at z <= near is culled, metres (gsplat's default)."""
    frustum_margin: float = 0.3
    """The Jacobian is evaluated inside the frustum widened by this share of tan(half field of view) (gsplat, Inria)."""
    low_pass: float = 0.0
    """Variance added to both image axes, px^2. 3DGS uses 0.3; on pixel-sized Gaussians that costs 7-9 dB, so only
    the effect anti_aliasing adds some, with compensation."""
    variance_min: float = 1e-10
    """A Gaussian whose projection has det <= variance_min * (a + c),
    so a smallest variance about this in px^2, is culled."""
    compensation: bool = False
    """Whether opacity is lowered by what the low pass adds:
    sqrt(det / det with it), so that a Gaussian keeps its energy (gsplat)."""
    compensation_min: float = 0.005
    """Lower bound of that factor; no gradient below (gsplat)."""
    alpha_min: float = 1 / 255
    """A contribution below this alpha is skipped."""
    alpha_max: float = 0.99
    """Alpha is capped here, so that 1 - alpha stays away from zero."""
    transmittance_stop: float = 0.9999e-4
    """The Gaussian that would bring the transmittance to this or below is dropped with all behind it. Just below (1
    - alpha_max)^2, so that two Gaussians at the cap are both seen whatever the rounding: without the second a pixel
    is 1 % too dark."""


class TooLarge(ValueError):
    """A scene or picture beyond what a back end's numbers hold."""


class Rendering(NamedTuple):
    """C pictures, premultiplied on black."""

    color: torch.Tensor  # [C, h, w, 3]
    """sum T alpha color, sRGB."""
    alpha: torch.Tensor  # [C, h, w]
    """sum T alpha, coverage 0..1."""
    depth: torch.Tensor | None  # [C, h, w]
    """sum T alpha z, metres; divide by alpha for the mean depth. None unless asked for."""
    normal: torch.Tensor | None  # [C, h, w, 3]
    """sum T alpha n, n the third axis in camera axes, turned towards the camera. None unless asked for."""
    masked: tuple[int, ...]
    """Of each camera: Gaussians left out because they, or their projections, were not finite."""
    backend: str
    """What rendered them."""


Backend = Literal["auto", "reference", "cpu", "gpu"]


@dataclass(frozen=True)
class Drawing:
    """How to draw."""

    cutoffs: Cutoffs = field(default_factory=Cutoffs)
    """Thresholds."""
    backend: Backend = "auto"
    """`auto`: for float32 Gaussians `cpu` on the CPU and `gpu` on a CUDA device
    where Triton is there, else `reference`."""
    threads: int = 1
    """Threads of the `cpu` back end; the result does not depend on it."""
