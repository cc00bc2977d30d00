"""Multi-scale structural similarity: Wang, Simoncelli, Bovik, "Multiscale structural similarity", 2003.

Five scales with the published weights, contrast and structure from all, luminance from the coarsest. Window, constants
and covariance are those of `ssim`, but only windows that lie inside the picture count, as in the authors' program.
Between scales 2x2 pixels are averaged; a last odd row or column is repeated.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.metrics.measures.declaration import Metric, MetricSettings, Pictures, Value, too_small
from posegaussian.stages.metrics.measures.ssim import SIGMA, WINDOW

WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the scales, finest first."""
SMALLEST = (WINDOW - 1) * 2 ** (len(WEIGHTS) - 1) + 1
"""Px a side must have for one window at the coarsest scale: 161. Fewer scales would be another measure under the
same name."""


def ms_ssim(picture: np.ndarray, truth: np.ndarray, data_range: float) -> float:
    """MS-SSIM in 0..1, the mean over channels of [h, w] or [h, w, C] pictures, in float64.

    A contrast term that is negative on average (a picture against its negative) has no real power: it counts as 0, and
    so does that channel. Raises ValueError for unequal shapes, for sides below 161 px, and for values that are not
    finite.
    """
    if picture.shape != truth.shape or min(picture.shape[:2]) < SMALLEST:
        raise ValueError(
            f"MS-SSIM compares pictures of equal shape with sides of {SMALLEST} px or more, got {picture.shape} and"
            f" {truth.shape}"
        )
    x, y = (np.atleast_3d(p.astype(np.float64)) for p in (picture, truth))
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("MS-SSIM of a picture that holds NaN or infinity")
    product = np.ones(x.shape[2])
    for scale, weight in enumerate(WEIGHTS):
        if scale:
            x, y = _halved(x), _halved(y)
        contrast, full = _terms(x, y, data_range)
        product *= np.maximum(full if scale == len(WEIGHTS) - 1 else contrast, 0) ** weight
    return float(product.mean())


def _terms(x: np.ndarray, y: np.ndarray, data_range: float) -> tuple[np.ndarray, np.ndarray]:
    """[C], [C]: means of contrast times structure, and of SSIM, over the windows inside the pictures [h, w, C]."""
    import cv2

    inside = slice(WINDOW // 2, -(WINDOW // 2))

    def blur(p: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(p, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_REFLECT).reshape(p.shape)[
            inside, inside
        ]

    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y, covariance = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2, blur(x * y) - mean_x * mean_y
    contrast = (2 * covariance + c2) / (var_x + var_y + c2)
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    return contrast.mean(axis=(0, 1)), (luminance * contrast).mean(axis=(0, 1))


def _halved(p: np.ndarray) -> np.ndarray:
    """[ceil(h / 2), ceil(w / 2), C] means of 2x2 pixels."""
    h, w = p.shape[:2]
    p = np.pad(p, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge")
    return (p[::2, ::2] + p[1::2, ::2] + p[::2, 1::2] + p[1::2, 1::2]) / 4


def _of_region(pictures: Pictures, settings: MetricSettings) -> Value:
    return too_small(pictures.picture, SMALLEST) or ms_ssim(*pictures[:3])


METRIC = Metric(
    "ms_ssim",
    "MS-SSIM",
    "1",
    "higher",
    lambda settings: (
        f"Wang 2003, 5 scales, windows inside the picture, data range 255, negative terms 0, sides of {SMALLEST} px"
        " or more, mean over RGB; a box is cut out and measured by itself"
    ),
    bytes_a_pixel=340,
    of_region=_of_region,
)
