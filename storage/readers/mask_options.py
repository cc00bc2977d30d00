"""Masks as their import found that they are to be read: what its options make of a file's values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.model.masks import without_line
from posegaussian.storage.readers import images


def read_as_meant(path: str | Path, options: Mapping[str, Any]) -> np.ndarray:
    """[h, w] uint8, 0..255 foreground, of a mask's file and its stream's options: with `alpha` the mask is its alpha,
    of a picture cut out before one colour `background` is that colour; `line` is what `line_widths` found, with
    `zero_one` masks hold 0 and 1, with `labels` all but 0 is the subject, and `range` are the values that mean 0 and
    255. Raises SourceError."""
    if (background := options.get("background")) is not None:
        mask = images.read_cut_out(path, background)
    else:
        mask = images.read_mask(path, bool(options.get("alpha")))
    if line := options.get("line"):
        mask = without_line(mask, line)
    if options.get("labels"):
        return np.where(mask > 0, np.uint8(255), np.uint8(0))
    if options.get("zero_one"):
        return mask * np.uint8(255)
    if ends := options.get("range"):
        black, white = ends
        spread = np.rint((np.arange(256) - black) * (255 / (white - black)))
        return np.clip(spread, 0, 255).astype(np.uint8)[mask]
    return mask
