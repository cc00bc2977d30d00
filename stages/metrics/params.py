"""Settings of the metrics stage."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from posegaussian.stages.contract.declaration import Params, setting

Measure = Literal["psnr", "ssim", "delta_ssim", "ms_ssim", "flip", "lpips_alex", "lpips_vgg"]
WeightFile = Literal["alex", "alex_linear", "vgg", "vgg_linear"]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

DEFAULT: list[Measure] = ["psnr", "ssim", "delta_ssim"]
"""Measures that cost milliseconds and need nothing."""
LPIPS: dict[str, tuple[WeightFile, WeightFile]] = {
    "lpips_alex": ("alex", "alex_linear"),
    "lpips_vgg": ("vgg", "vgg_linear"),
}
"""{measure: files of its network and of its linear layers}."""


class MetricsParams(Params):
    """What is measured."""

    measures: list[Measure] = setting(
        DEFAULT,
        "What is measured; each runs only when named here.",
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
    def _each_once(cls, value: list[Measure]) -> list[Measure]:
        if twice := sorted({m for m in value if value.count(m) > 1}):
            raise ValueError(f"{', '.join(twice)} named twice; name each measure once")
        return value

    @property
    def of_neighbours(self) -> bool:
        """Whether a frame is compared with the one before."""
        return "delta_ssim" in self.measures
