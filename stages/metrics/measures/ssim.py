"""Structural similarity, one definition: Wang et al. 2004 with an 11x11 Gaussian window of sigma 1.5.

Biased covariance, K1 = 0.01, K2 = 0.03, float64, edges reflected (the edge pixel repeats) so that the map has the
picture's size, and the mean over channels. skimage's `gaussian_weights=True, use_sample_covariance=False` agrees, but
for the border it crops.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.metrics.measures.declaration import Metric

WINDOW = 11
SIGMA = 1.5
DEFINITION = "Gaussian window 11x11, sigma 1.5, biased covariance, data range 255, reflected border, mean over RGB"


def ssim_map(picture: np.ndarray, truth: np.ndarray, data_range: float) -> np.ndarray:
    """[h, w] float64 SSIM at every pixel, in [-1, 1], the mean over channels of [h, w] or [h, w, C] pictures.

    Variances are differences of nearly equal numbers where a picture is nearly constant: float64 leaves 1e-11 of 255^2,
    against the constant 58.5 beside them (float32 would move SSIM by 5e-5). Raises ValueError for unequal shapes, for
    no pixels and for values that are not finite.
    """
    import cv2

    if picture.shape != truth.shape or picture.size == 0:
        raise ValueError(
            f"SSIM compares pictures of equal shape with at least one pixel, got {picture.shape} and {truth.shape}"
        )
    x, y = (np.atleast_3d(p.astype(np.float64)) for p in (picture, truth))
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("SSIM of a picture that holds NaN or infinity")

    def blur(p: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(p, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_REFLECT).reshape(p.shape)

    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y, covariance = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2, blur(x * y) - mean_x * mean_y
    similarity = (
        (2 * mean_x * mean_y + c1) * (2 * covariance + c2) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))
    )
    return similarity.mean(axis=2)


METRIC = Metric(
    "ssim",
    "SSIM",
    "1",
    "higher",
    lambda settings: DEFINITION,
    bytes_a_pixel=288,
    of_pixels=lambda pictures, settings: ssim_map(*pictures[:3]),
    traded=True,
)
