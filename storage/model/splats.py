"""A scene of 3D Gaussians as files of the splatting world hold it: plain arrays in the conventions of 3DGS.

World axes and units are whatever the file's author chose; nothing is converted. Quaternions are (w, x, y, z). Colour of
degree 0: sRGB = 0.5 + SH0 * coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

SH0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi))."""


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians; all arrays float32. Values are as in the file:
    quaternions of any length, numbers that may not be finite."""

    mean: np.ndarray
    """[N, 3] centres."""
    log_scale: np.ndarray
    """[N, 3] natural logarithm of the standard deviation along each axis."""
    quaternion: np.ndarray
    """[N, 4] (w, x, y, z), not normalised: turns the Gaussian's axes to the world's."""
    opacity_logit: np.ndarray
    """[N] log(a / (1 - a)) of the alpha at the centre."""
    harmonics: np.ndarray
    """[N, K, 3] coefficients of the real spherical harmonics for red, green and blue,
    K = (degree + 1)^2 = 1, 4, 9 or 16."""

    def __post_init__(self) -> None:
        """Raise ValueError for arrays that do not belong together."""
        n, k = len(self.mean), self.harmonics.shape[1] if self.harmonics.ndim == 3 else 0
        wanted = {
            "mean": (n, 3),
            "log_scale": (n, 3),
            "quaternion": (n, 4),
            "opacity_logit": (n,),
            "harmonics": (n, k, 3),
        }
        for f in fields(self):
            array = getattr(self, f.name)
            if array.shape != wanted[f.name] or array.dtype != np.float32:
                raise ValueError(
                    f"{f.name} is {array.dtype} {array.shape}; float32 {wanted[f.name]} is expected for {n} Gaussians"
                )
        if k not in (1, 4, 9, 16):
            raise ValueError(
                f"harmonics has {k} coefficients a colour; 1, 4, 9 or 16 are expected (degree 0, 1, 2 or 3)"
            )

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0..3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.harmonics.shape[1]]
