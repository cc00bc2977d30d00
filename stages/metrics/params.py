"""Settings of the metrics stage."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.metrics.measures.declaration import WeightFile
from posegaussian.stages.metrics.measures.registry import METRICS

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

DEFAULT = ["psnr", "ssim", "delta_ssim"]
"""Measures that cost milliseconds and need nothing."""


class MetricsParams(Params):
    """What is measured."""

    measures: list[str] = setting(
        DEFAULT,
        f"What is measured, of {', '.join(METRICS)}; each runs only when named here.",
        quality_levels=[["psnr"], DEFAULT, [*DEFAULT, "ms_ssim"]],
        min_length=1,
    )
    psnr_cap: float = setting(100.0, "PSNR of identical pictures, which would be infinite.", unit="dB", gt=0, le=200)
    flip_pixels_per_degree: float = setting(
        67.02064,
        "Pixels in a degree of the viewer's eye for FLIP; the default is a 0.7 m wide display of 3840 px at 0.7 m.",
        unit="px",
        gt=0,
        le=1000,
    )
    lpips_weights: dict[WeightFile, str] = setting(
        {},
        "Paths of the official weight files for LPIPS: network (alex, vgg) and linear layers (alex_linear,"
        " vgg_linear).",
        volatile=True,
    )
    lpips_sha256: dict[WeightFile, Sha256] = setting(
        {}, "The sha256 of each of these files, as `sha256sum FILE` prints it."
    )

    @field_validator("measures")
    @classmethod
    def _known_and_each_once(cls, value: list[str]) -> list[str]:
        if unknown := [m for m in value if m not in METRICS]:
            raise ValueError(f"there is no measure {unknown[0]!r}; there are {', '.join(METRICS)}")
        if twice := sorted({m for m in value if value.count(m) > 1}):
            raise ValueError(f"{', '.join(twice)} named twice; name each measure once")
        return value

    @property
    def before(self) -> MetricsParams:
        """What is measured of a frame that only the next one is compared with."""
        changing = dict.fromkeys(c for m in self.measures if (c := METRICS[m].change_of))
        return self.model_copy(update={"measures": list(changing)})

    @property
    def of_neighbours(self) -> bool:
        """Whether a frame is compared with the one before."""
        return any(METRICS[m].change_of for m in self.measures)
