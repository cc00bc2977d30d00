"""Settings of the metrics stage."""

from __future__ import annotations

from stages.contract import Params, setting


class MetricsParams(Params):
    """What is measured."""

    psnr_cap: float = setting(100.0, "PSNR of identical pictures, which would be infinite.", unit="dB", gt=0, le=200)
