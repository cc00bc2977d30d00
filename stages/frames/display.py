"""Pictures as 8-bit sRGB, whatever the file held."""

from __future__ import annotations

import numpy as np


def to_display(picture: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8 sRGB: an 8-bit picture as it is; linear float light encoded by IEC 61966-2-1 and clipped to 0..1.

    Light above 1 is lost: `frames/color` is display-referred. NaN counts as 0 and infinity as 1.
    """
    if picture.dtype == np.uint8:
        return picture
    linear = np.clip(np.nan_to_num(picture.astype(np.float32), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
    return np.rint(encoded * 255.0).astype(np.uint8)
