"""Between splat files and the rasterizer: a scene with view-dependent colour, and Gaussians as splats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.storage.model.splats import SH0, Splats

MOST_OPAQUE = 1 - 2.0**-20
"""Alpha above which a logit says no more: exactly 1 would be infinite."""


@dataclass(frozen=True, eq=False)
class SplatScene:
    """A splat file's Gaussians: all but the colour is the same for every camera.
    World axes and units are the file's."""

    mean: torch.Tensor  # [N, 3]
    """Centres."""
    rotation: torch.Tensor  # [N, 3, 3]
    """Columns are the unit axes in the world."""
    scale: torch.Tensor  # [N, 3]
    """Standard deviations along the columns of `rotation`."""
    opacity: torch.Tensor  # [N]
    """Alpha at the centre, 0..1."""
    harmonics: torch.Tensor  # [N, K, 3]
    """Spherical harmonics of the colour."""

    def seen_from(self, camera: Camera, degree: int = 3) -> Gaussians:
        """The Gaussians in the colours they show to a camera, harmonics up to `degree` (or the file's own) counted."""
        centre = torch.as_tensor(camera.centre, dtype=self.mean.dtype, device=self.mean.device)
        return Gaussians(
            self.mean, self.rotation, self.scale, self.opacity, sh_color(self.harmonics, self.mean - centre, degree)
        )


def scene_of(splats: Splats, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> SplatScene:
    """Exponential of the log scales, logistic function of the opacity logits, rotation matrices of the normalised
    quaternions.

    What is not finite stays so, and so does a quaternion of length 0 (its rotation is NaN): the rasterizer masks and
    counts such Gaussians.
    """

    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    scale, opacity = torch.exp(tensor(splats.log_scale)), torch.sigmoid(tensor(splats.opacity_logit))
    return SplatScene(
        tensor(splats.mean), rotations(tensor(splats.quaternion)), scale, opacity, tensor(splats.harmonics)
    )


def sh_color(harmonics: torch.Tensor, direction: torch.Tensor, degree: int = 3) -> torch.Tensor:
    """[N, 3] max(0, 0.5 + sum_k Y_k(d) c_k): sRGB, 0 or more, as 3DGS defines it.

    Args:
        harmonics: [N, K, 3] coefficients, K = 1, 4, 9 or 16.
        direction: [N, 3] from the camera's centre to the mean, of any length; of length 0, degree 0 alone counts.
        degree: highest degree that counts, 0..3.

    The basis is that of Sloan, "Efficient Spherical Harmonic Evaluation", 2013, with the signs of 3DGS.
    """
    if degree not in (0, 1, 2, 3):
        raise ValueError(f"degree {degree} of spherical harmonics; 0, 1, 2 or 3 is expected")
    count = min((degree + 1) ** 2, harmonics.shape[1])
    length = torch.sqrt((direction * direction).sum(dim=1, keepdim=True))
    d = torch.where(length > 0, direction / torch.where(length > 0, length, 1), 0)
    basis = _basis(d, count)  # K x [N]
    color = torch.full_like(harmonics[:, 0], 0.5)
    for k, b in enumerate(basis):
        color = color + b[:, None] * harmonics[:, k]
    return color.clamp(min=0)


def _basis(d: torch.Tensor, count: int) -> list[torch.Tensor]:
    """The first `count` real spherical harmonics of unit directions [N, 3]."""
    x, y, z = d[:, 0], d[:, 1], d[:, 2]
    found = [torch.full_like(x, SH0)]
    if count > 1:
        found += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        found += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy)]
        found += [-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)]
    if count > 9:
        found += [
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
        ]
        found += [0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy), -0.4570457994644658 * x * (4 * zz - xx - yy)]
        found += [1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3 * yy)]
    return found


def quaternions(rotation: np.ndarray) -> np.ndarray:
    """[N, 4] float64 unit quaternions (w, x, y, z), w >= 0, of rotation matrices [N, 3, 3].

    By the largest of the four components (Shepperd, 1978), so that nothing is divided by a small number.
    """
    r = rotation.astype(np.float64)
    diagonal = np.stack([r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]])
    trace = diagonal.sum(axis=0)
    a, b, c = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    d, e, f = r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] + r[:, 1, 2]
    x, y, z = (1 + 2 * diagonal[i] - trace for i in range(3))
    candidates = np.stack(
        [np.stack(q, axis=1) for q in ((1 + trace, a, b, c), (a, x, d, e), (b, d, y, f), (c, e, f, z))]
    )  # [4, N, 4]
    largest = np.argmax(np.stack([trace, *diagonal]), axis=0)
    q = candidates[largest, np.arange(len(r))]
    q /= np.sqrt((q * q).sum(axis=1, keepdims=True))
    return np.where(q[:, :1] < 0, -q, q)


def splats_of(gaussians: Gaussians) -> Splats:
    """Gaussians of one colour each as splats of degree 0. Alpha is bounded by `MOST_OPAQUE`, as its logit must be
    finite.

    Raises ValueError where something is not finite, a scale is not positive or an opacity not in (0, 1].
    """
    mean, rotation, scale, opacity, color = (
        getattr(gaussians, n).detach().cpu().numpy().astype(np.float64)
        for n in ("mean", "rotation", "scale", "opacity", "color")
    )
    for name, values in (
        ("mean", mean),
        ("rotation", rotation),
        ("scale", scale),
        ("opacity", opacity),
        ("color", color),
    ):
        if not np.isfinite(values).all():
            raise ValueError(
                f"{int((~np.isfinite(values)).sum())} values of {name} are not finite;"
                " a splat file holds finite Gaussians"
            )
    if (scale <= 0).any() or (opacity <= 0).any() or (opacity > 1).any():
        raise ValueError(
            f"scale {scale.min(initial=1):g} or opacity {opacity.min(initial=1):g}..{opacity.max(initial=0):g}; scales"
            " above 0 and opacities in (0, 1] are expected"
        )
    alpha = np.minimum(opacity, MOST_OPAQUE)
    parts = (
        mean,
        np.log(scale),
        quaternions(rotation),
        np.log(alpha) - np.log1p(-alpha),
        ((color - 0.5) / SH0)[:, None, :],
    )
    return Splats(*(p.astype(np.float32) for p in parts))
