"""The change of SSIM from one frame to the next: what flickers changes."""

from __future__ import annotations

from posegaussian.stages.metrics.measures.declaration import Metric
from posegaussian.stages.metrics.measures.ssim import DEFINITION

METRIC = Metric(
    "delta_ssim",
    "Change of SSIM",
    "1",
    "lower",
    lambda settings: "abs(SSIM of this frame - SSIM of the previous frame); " + DEFINITION,
    bytes_a_pixel=288,
    change_of="ssim",
)
