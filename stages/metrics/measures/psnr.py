"""Peak signal-to-noise ratio, capped: identical pictures would be infinite and poison every mean."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.metrics.measures.declaration import Metric, MetricSettings, Pictures


def psnr(picture: np.ndarray, truth: np.ndarray, data_range: float, cap: float) -> float:
    """10 log10(data_range^2 / mean squared error) in dB over all pixels and channels, at most `cap`.

    picture, truth: [...] of equal shape, any real dtype, computed in float64. Raises ValueError for unequal shapes, for
    no pixels, and for values that are not finite.
    """
    if picture.shape != truth.shape or picture.size == 0:
        raise ValueError(
            f"PSNR compares pictures of equal shape with at least one pixel, got {picture.shape} and {truth.shape}"
        )
    error = picture.astype(np.float64) - truth.astype(np.float64)
    mse = float(np.mean(error * error))
    if not np.isfinite(mse):
        raise ValueError("PSNR of a picture that holds NaN or infinity")
    return cap if mse == 0 else min(cap, 10 * np.log10(data_range**2 / mse))


def _of_region(pictures: Pictures, settings: MetricSettings) -> float:
    picture, truth, data_range, visible = pictures
    if visible is not None and visible.any():
        picture, truth = picture[visible], truth[visible]
    return psnr(picture, truth, data_range, settings.psnr_cap)


METRIC = Metric(
    "psnr",
    "PSNR",
    "dB",
    "higher",
    lambda settings: f"10 log10(255^2 / MSE) over RGB, at most {settings.psnr_cap:g} dB",
    bytes_a_pixel=100,
    of_region=_of_region,
    traded=True,
)
