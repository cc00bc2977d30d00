"""Settings of the frames stage, and how `matte: auto` is resolved."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import (
    BLAZEPOSE,
    ESTIMATED,
    JOINTS2D,
    JOINTS3D,
    MASKS,
    SEGMENTED,
    SEVERAL_FRAMES,
    Facts,
)
from posegaussian.stages.detection.params import ADDED
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.splits import PROTOCOLS
from posegaussian.storage.model.timegrid import parse_range

Matte = Literal["given", "person", "plate", "none"]
JOINTS = frozenset({JOINTS2D, JOINTS3D})
"""Facts: joints of either kind are known, given or estimated."""


class FramesParams(Params):
    """Which frames, at which size, with which matte."""

    range: str = setting(
        "::",
        "Source frames as start:stop:stride; empty parts mean from the first, to the last, every one; or a protocol of"
        " the data set, whose test frames they are. It enters a fingerprint through the partition's frames alone.",
        volatile=True,
    )
    size: int | None = setting(
        None,
        "Longest side of the pictures that are worked on, as filmed: without its lens a wide one reaches farther."
        " null keeps the calibrated size. Never enlarges.",
        unit="px",
        quality_levels=[128, 256, 512, 1024, None],
        ge=16,
        le=16384,
    )
    crop: dict[str, Crop] = setting(
        {},
        "Per camera, for letterboxed or scaled videos: captured pixel x to calibrated pixel scale * x + offset."
        " Overrules what the import found.",
    )
    time_offset: dict[str, float] = setting(
        {},
        "Per camera out of step, frames by which it is late, as `posegaussian inspect` measures them: its picture n +"
        " offset, rounded to a whole frame, is used for frame n.",
        unit="frames",
    )
    matte: Literal["auto", "given", "person", "plate", "none"] = setting(
        "auto",
        "Where the foreground mask comes from: masks that came with the capture, the person that joints and an"
        " estimator tell, a background plate of a static camera, or none (everything is foreground).",
    )
    plate_threshold: float = setting(
        30.0, "Colour distance from the plate above which a pixel is foreground.", unit="1/255", gt=0, le=255
    )
    hint_margin: float = setting(
        0.03,
        "How far an estimator's segmentation of the person may be off, share of the side of the square it looked at.",
        gt=0,
        le=0.2,
    )

    @field_validator("range")
    @classmethod
    def _range_parses(cls, text: str) -> str:
        if text not in PROTOCOLS:
            parse_range(text)
        elif not PROTOCOLS[text].frames:
            told = [n for n, p in PROTOCOLS.items() if p.frames]
            raise ValueError(f"protocol {text} tells no frames; these do: {', '.join(told)}")
        return text


def resolve_matte(params: FramesParams, facts: Facts) -> Matte:
    """What `auto` means for this capture."""
    return matte_choice(params, facts)[0]


def matte_choice(params: FramesParams, facts: Facts) -> tuple[Matte, str]:
    """The matte and one sentence that says why, for the table of effects: given masks, then the person, then a
    plate, which needs several frames."""
    if params.matte != "auto":
        return params.matte, f"frames.matte is {params.matte}"
    if MASKS in facts:
        return "given", "the capture came with masks of every view"
    helped = ", and several frames show the background, which helps" if SEVERAL_FRAMES in facts else ""
    if facts & JOINTS:
        return "person", f"no masks came with the capture; {_who(facts)}{helped}"
    if SEVERAL_FRAMES in facts:
        return "plate", "no masks came with the capture and no joints are known, but several frames show the background"
    return "none", "no masks came with the capture, no joints are known, and a single frame shows no background"


def _who(facts: Facts) -> str:
    """What tells where the person is."""
    if SEGMENTED not in facts:
        return "joints tell where the person is"
    return (
        "the estimator of joints segments the person"
        if ESTIMATED in facts
        else "BlazePose segments the person whose joints are given"
    )


def wants_segmentation(params: FramesParams, facts: Facts) -> bool:
    """Whether the matte would be the better for a segmentation of the person, by an estimator that is here."""
    return bool(facts & JOINTS) and resolve_matte(params, facts) == "person"


def better_matte(params: FramesParams, facts: Facts) -> str | None:
    """One sentence about what would make a better matte than this capture gets, with the command;
    None where nothing would."""
    answer = resolve_matte(params, facts)
    if params.matte != "auto" or answer == "given" or facts & {SEGMENTED, BLAZEPOSE}:
        return None
    so_far = {
        "person": "the person is cut out by the joints",
        "plate": "the foreground is what differs from a background plate",
        "none": "everything is foreground",
    }[answer]
    return f"frames.matte: {so_far}; BlazePose would segment the person, which is better: {ADDED}"
