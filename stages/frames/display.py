"""Pictures as 8-bit sRGB, whatever the file held, and gains on their light."""

from __future__ import annotations

import numpy as np


def to_display(picture: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8 sRGB: an 8-bit picture as it is; linear float light encoded by IEC 61966-2-1 and clipped to 0..1.

    Light above 1 is lost: `frames/color` is display-referred. NaN counts as 0 and infinity as 1.
    """
    if picture.dtype == np.uint8:
        return picture
    linear = np.clip(np.nan_to_num(picture.astype(np.float32), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.rint(_encode(linear) * 255.0).astype(np.uint8)


def to_linear(color: np.ndarray) -> np.ndarray:
    """Turn sRGB values 0..255 into linear light 0..1, by IEC 61966-2-1; the inverse of the encoding in `to_display`."""
    encoded = np.asarray(color, dtype=np.float64) / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def to_srgb(light: np.ndarray) -> np.ndarray:
    """Turn linear light into sRGB values 0..255, not rounded; light is clipped to 0..1. The inverse of `to_linear`."""
    return _encode(np.clip(np.asarray(light, dtype=np.float64), 0.0, 1.0)) * 255.0


def gain_table(gain: np.ndarray) -> np.ndarray:
    """[1, 256, 3] uint8: what each sRGB value of each channel becomes when its light is multiplied by `gain` [3]; for `cv2.LUT`."""
    linear = np.clip(to_linear(np.arange(256))[:, None] * gain, 0.0, 1.0)
    return np.rint(_encode(linear) * 255.0).astype(np.uint8)[None]


def _encode(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
