"""The crop and scale between a video and the picture its calibration was made for."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from posegaussian.storage.model.errors import ConfigError

Offset = Annotated[float, Field(ge=-1e5, le=1e5)]


class Crop(BaseModel):
    """Similarity from a captured (video) pixel to a calibrated pixel, both in our pixel centres:
    x' = scale x + offset."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    scale: float = Field(1.0, ge=1e-3, le=1e3, description="Calibrated pixels per captured pixel.")
    offset: tuple[Offset, Offset] = Field((0.0, 0.0), description="(dx, dy) in calibrated pixels.")


def unexplained_sizes(
    names: Sequence[str], captured: Sequence[tuple[int, int]], calibrated: np.ndarray, known: Collection[str]
) -> list[str]:
    """Sentences about cameras whose pictures have another size (width, height) px than their calibration [V, 2], and
    nothing says how they relate: archives made before imports found that out. `known`: cameras whose crop is known."""
    return [
        f"camera {n}: pictures are {w}x{h} px, the calibration is for {cw}x{ch} px; import the capture again, which"
        " finds out how they relate, or say it with frames.crop"
        for n, (w, h), (cw, ch) in zip(names, captured, calibrated.tolist(), strict=True)
        if (w, h) != (cw, ch) and n not in known
    ]


def captured_to_calibrated(names: Sequence[str], crops: Mapping[str, Crop]) -> np.ndarray:
    """[V, 3] (scale, dx, dy) of every camera: a captured pixel x is the calibrated pixel scale x + (dx, dy).

    Raises ConfigError for a crop of a camera that is not among the names.
    """
    for name in crops:
        if name not in names:
            raise ConfigError(f"frames.crop: no camera named {name!r}; the rig has {', '.join(names)}")
    out = np.tile([1.0, 0.0, 0.0], (len(names), 1))
    for v, name in enumerate(names):
        if name in crops:
            out[v] = crops[name].scale, *crops[name].offset
    return out


def crop_settings(choices: Mapping[str, Sequence[tuple[Crop, str]]]) -> list[str]:
    """`frames.crop` as lines of YAML to copy: per camera the first of its (crop, meaning) as the value, the others as
    comments.

    All lines are indented alike, so that they are told from a sentence and are YAML as they stand.
    """
    lines = ["  frames:", "    crop:"]
    for name, (first, *others) in choices.items():
        # A JSON text is a YAML key whatever the name holds: 01 stays a text.
        key = name if re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) else json.dumps(name)
        lines += [
            f"      {mark}{key}: {{scale: {c.scale:.6g}, offset: [{c.offset[0]:.6g}, {c.offset[1]:.6g}]}}  # {how}"
            for mark, (c, how) in [("", first), *(("# ", o) for o in others)]
        ]
    return lines
