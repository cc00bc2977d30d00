"""The crop and scale between a video and the picture its calibration was made for."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class Crop(BaseModel):
    """Similarity from a captured (video) pixel to a calibrated pixel, both in our pixel centres: x' = scale x + offset."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    scale: float = Field(1.0, gt=0, description="Calibrated pixels per captured pixel.")
    offset: tuple[float, float] = Field((0.0, 0.0), description="(dx, dy) in calibrated pixels.")
