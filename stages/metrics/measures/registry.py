"""The metrics by name. A further one is a file of this folder and its entry here."""

from __future__ import annotations

from collections.abc import Mapping

from posegaussian.stages.metrics.measures.declaration import Metric
from posegaussian.stages.metrics.measures.delta_ssim import METRIC as DELTA_SSIM
from posegaussian.stages.metrics.measures.flip import METRIC as FLIP
from posegaussian.stages.metrics.measures.lpips import LPIPS_ALEX, LPIPS_VGG
from posegaussian.stages.metrics.measures.ms_ssim import METRIC as MS_SSIM
from posegaussian.stages.metrics.measures.psnr import METRIC as PSNR
from posegaussian.stages.metrics.measures.ssim import METRIC as SSIM

METRICS: Mapping[str, Metric] = {m.name: m for m in (PSNR, SSIM, DELTA_SSIM, MS_SSIM, FLIP, LPIPS_ALEX, LPIPS_VGG)}
"""In the order in which help and figures name them."""
