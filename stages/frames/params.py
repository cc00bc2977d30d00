"""Settings of the frames stage, and how `matte: auto` is resolved."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from stages.contract import Facts, Params, setting
from storage.crop import Crop
from storage.timegrid import parse_range

Matte = Literal["given", "person", "plate", "none"]
SEGMENTED = "segmented"
"""Fact: what estimates the joints segments the person, too."""
GIVEN_DEPTH = "given_depth"
"""The fact that every source view has depth maps to reconstruct from."""


class FramesParams(Params):
    """Which frames, at which size, with which matte."""

    range: str = setting("::", "Source frames as start:stop:stride; empty parts mean from the first, to the last, every one. It enters a fingerprint through the partition's frames alone.", volatile=True)
    size: int | None = setting(None, "Longest side of the pictures that are worked on; null keeps the calibrated size. Never enlarges.", unit="px", quality_levels=[128, 256, 512, 1024, None], ge=16, le=16384)
    crop: dict[str, Crop] = setting({}, "Per camera, for letterboxed or scaled videos: captured pixel x to calibrated pixel scale * x + offset. Overrules what the import found.")
    time_offset: dict[str, float] = setting({}, "Per camera out of step, frames by which it is late, as `posegaussian inspect` measures them: its picture n + offset, rounded to a whole frame, is used for frame n.", unit="frames")
    matte: Literal["auto", "given", "person", "plate", "none"] = setting(
        "auto", "Where the foreground mask comes from: masks that came with the capture, the person that the estimator found, a background plate of a static camera, or none (everything is foreground)."
    )
    plate_threshold: float = setting(30.0, "Colour distance from the plate above which a pixel is foreground.", unit="1/255", gt=0, le=255)
    hint_margin: float = setting(0.03, "How far an estimator's segmentation of the person may be off, share of the side of the square it looked at.", gt=0, le=0.2)

    @field_validator("range")
    @classmethod
    def _range_parses(cls, text: str) -> str:
        parse_range(text)
        return text


def resolve_matte(params: FramesParams, facts: Facts) -> Matte:
    """What `auto` means for this capture."""
    return matte_choice(params, facts)[0]


def matte_choice(params: FramesParams, facts: Facts) -> tuple[Matte, str]:
    """The matte and one sentence that says why, for the table of effects: given masks, then the person, then a plate, which needs several frames."""
    if params.matte != "auto":
        return params.matte, f"frames.matte is {params.matte}"
    if "masks" in facts:
        return "given", "the capture came with masks of every view"
    if SEGMENTED in facts:
        helped = ", and several frames show the background, which helps" if "several_frames" in facts else ""
        return "person", f"no masks came with the capture; the estimator of joints segments the person{helped}"
    if "several_frames" in facts:
        return "plate", "no masks came with the capture, and several frames show the background"
    return "none", "no masks came with the capture, and a single frame shows no background"
