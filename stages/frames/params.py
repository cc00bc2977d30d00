"""Settings of the frames stage, and how `matte: auto` is resolved."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from stages.contract import Facts, Params, setting
from storage.crop import Crop
from storage.timegrid import parse_range

GIVEN_DEPTH = "given_depth"
"""The fact that every source view has depth maps to reconstruct from."""


class FramesParams(Params):
    """Which frames, at which size, with which matte."""

    range: str = setting("::", "Source frames as start:stop:stride; empty parts mean from the first, to the last, every one. It enters a fingerprint through the partition's frames alone.", volatile=True)
    size: int | None = setting(None, "Longest side of the pictures that are worked on; null keeps the calibrated size. Never enlarges.", unit="px", quality_levels=[128, 256, 512, 1024, None], ge=16, le=16384)
    crop: dict[str, Crop] = setting({}, "Per camera, for letterboxed or scaled videos: captured pixel x to calibrated pixel scale * x + offset.")
    matte: Literal["auto", "given", "plate", "none"] = setting("auto", "Where the foreground mask comes from: masks that came with the capture, a background plate of a static camera, or none (everything is foreground).")
    plate_threshold: float = setting(30.0, "Colour distance from the plate above which a pixel is foreground.", unit="1/255", gt=0, le=255)

    @field_validator("range")
    @classmethod
    def _range_parses(cls, text: str) -> str:
        parse_range(text)
        return text


def resolve_matte(params: FramesParams, facts: Facts) -> Literal["given", "plate", "none"]:
    """What `auto` means for this capture: given masks before a plate; a plate needs several frames."""
    return matte_choice(params, facts)[0]


def matte_choice(params: FramesParams, facts: Facts) -> tuple[Literal["given", "plate", "none"], str]:
    """The matte and one sentence that says why; for the table of effects."""
    if params.matte != "auto":
        return params.matte, f"frames.matte is {params.matte}"
    if "masks" in facts:
        return "given", "the capture came with masks of every view"
    if "several_frames" in facts:
        return "plate", "no masks came with the capture, and several frames show the background"
    return "none", "no masks came with the capture, and a single frame shows no background"
