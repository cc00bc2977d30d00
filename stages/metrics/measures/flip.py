"""LDR-FLIP, the difference seen when two pictures alternate: Andersson et al., 2020, by the authors' own
`flip-evaluator`."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.metrics.measures.declaration import Metric, MetricSettings, Pictures

PACKAGE = "flip-evaluator"
"""Its name on the package index; imported as `flip_evaluator`."""


def missing() -> str | None:
    """What to do where the package is not installed, or None."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        version(PACKAGE)
    except PackageNotFoundError:
        return (
            f"metrics.measures names flip, and the package {PACKAGE} is not installed; `pip install"
            " 'posegaussian[flip]'`, or leave flip out"
        )
    return None


def flip_map(picture: np.ndarray, truth: np.ndarray, data_range: float, pixels_per_degree: float) -> np.ndarray:
    """[h, w] float32 FLIP in 0..1 at every pixel of sRGB pictures [h, w, 3]; the edge pixel repeats beyond the border.

    Raises ValueError for other shapes and for values that are not finite or outside 0..data_range.
    """
    import flip_evaluator

    if picture.shape != truth.shape or picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
        raise ValueError(
            f"FLIP compares pictures [h, w, 3] of equal shape with at least one pixel, got {picture.shape} and"
            f" {truth.shape}"
        )
    for p in (picture, truth):
        if not (np.isfinite(p).all() and p.min() >= 0 and p.max() <= data_range):
            raise ValueError(f"FLIP of a picture with values that are not finite or outside 0..{data_range:g}")
    given, expected = (np.ascontiguousarray(p / data_range, np.float32) for p in (picture, truth))
    settings = {"ppd": float(pixels_per_degree)}
    found, _, _ = flip_evaluator.evaluate(
        expected, given, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False, parameters=settings
    )
    return np.asarray(found)[..., 0]


def _of_pixels(pictures: Pictures, settings: MetricSettings) -> np.ndarray:
    return flip_map(*pictures[:3], settings.flip_pixels_per_degree)


METRIC = Metric(
    "flip",
    "FLIP",
    "1",
    "lower",
    lambda settings: f"LDR-FLIP, {settings.flip_pixels_per_degree:g} px a degree, mean of the full picture's map",
    bytes_a_pixel=210,
    of_pixels=_of_pixels,
    refusal=lambda settings: missing(),
)
