"""Measures beside PSNR and SSIM: what a task loads once for them, and why one of them has no value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.metrics.params import LPIPS, MetricsParams

Regions = Mapping[str, tuple[slice, slice]]
"""{name: rows and columns}."""
UNAVAILABLE = "not available: "
"""How the definition of a row without a value begins."""


@dataclass(frozen=True)
class Unavailable:
    """Stands where a number would be."""

    reason: str
    """What is missing, and what to do."""


def further(
    picture: np.ndarray, truth: np.ndarray, regions: Regions, data_range: float, params: MetricsParams
) -> dict[tuple[str, str], float | Unavailable]:
    """{(region, measure): value} of those of `params.measures` that are not PSNR or SSIM.

    picture, truth: [h, w, 3] 0..data_range, sRGB. FLIP is the mean of the full picture's map over the region, as SSIM
    is; MS-SSIM and LPIPS have no map: their regions are cut out first and measured by themselves.
    """
    values: dict[tuple[str, str], float | Unavailable] = {}
    if "flip" in params.measures:
        from posegaussian.stages.metrics.flip import flip_map

        seen = flip_map(picture, truth, data_range, params.flip_pixels_per_degree)
        values |= {(name, "flip"): float(seen[region].astype(np.float64).mean()) for name, region in regions.items()}
    for measure in ("ms_ssim", *LPIPS):
        if measure in params.measures:
            for name, region in regions.items():
                values[name, measure] = _cut_out(measure, picture[region], truth[region], data_range, params)
    return values


def _cut_out(
    measure: str, picture: np.ndarray, truth: np.ndarray, data_range: float, params: MetricsParams
) -> float | Unavailable:
    """One measure of one region."""
    if measure == "ms_ssim":
        from posegaussian.stages.metrics.ms_ssim import SMALLEST, ms_ssim

        return _too_small(picture, SMALLEST) or ms_ssim(picture, truth, data_range)
    if reason := without_weights(measure, params):
        return Unavailable(reason)
    from posegaussian.stages.metrics.lpips import STACKS
    from posegaussian.stages.metrics.lpips_weights import load_network

    small = _too_small(picture, STACKS[measure].smallest)
    if small:
        return small
    files = [part for name in LPIPS[measure] for part in (params.lpips_weights[name], params.lpips_sha256[name])]
    return load_network(measure, *files).distance(picture, truth, data_range)


def _too_small(picture: np.ndarray, smallest: int) -> Unavailable | None:
    h, w = picture.shape[:2]
    return Unavailable(f"a region of less than {smallest} px height or width") if min(h, w) < smallest else None


def without_weights(measure: str, params: MetricsParams) -> str | None:
    """What settings of LPIPS lack for a measure, or None."""
    missing = [name for name in LPIPS[measure] if name not in params.lpips_weights]
    return (
        f"no weight files; give {' and '.join(f'metrics.lpips_weights.{name}' for name in missing)} with their"
        " metrics.lpips_sha256"
        if missing
        else None
    )


def definitions(params: MetricsParams) -> dict[str, str]:
    """{measure: what exactly it is} of the measures beside PSNR and SSIM."""
    from posegaussian.stages.metrics.ms_ssim import SMALLEST

    cut = "; a box is cut out and measured by itself"
    lpips = "LPIPS 0.1, {}, RGB -1..1" + cut
    return {
        "ms_ssim": (
            f"Wang 2003, 5 scales, windows inside the picture, data range 255, negative terms 0, sides of {SMALLEST} px"
            " or more, mean over RGB" + cut
        ),
        "flip": f"LDR-FLIP, {params.flip_pixels_per_degree:g} px a degree, mean of the full picture's map",
        "lpips_alex": lpips.format("AlexNet"),
        "lpips_vgg": lpips.format("VGG16"),
    }
