"""Pictures as 8-bit sRGB, whatever the file held, and gains on their light."""

from __future__ import annotations

import numpy as np

HALF_MAX = float(np.finfo(np.float16).max)


def to_display(picture: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8 sRGB: an 8-bit picture as it is; linear float light encoded by IEC 61966-2-1 and clipped to 0..1.

    Light above 1 is lost here; `tone_mapped` keeps it. NaN counts as 0 and infinity as 1.
    """
    if picture.dtype == np.uint8:
        return picture
    linear = np.clip(np.nan_to_num(picture.astype(np.float32), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.rint(_encode(linear) * 255.0).astype(np.uint8)


def to_linear(color: np.ndarray) -> np.ndarray:
    """Turn sRGB values 0..255 into linear light 0..1, by IEC 61966-2-1; the inverse of the encoding in `to_display`."""
    encoded = np.asarray(color, dtype=np.float64) / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def tone_mapped(picture: np.ndarray, gain: np.ndarray, white: float) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of linear light [h, w, 3] (or of an 8-bit picture) times `gain` [3], with what lies beyond
    white brought below it.

    Extended Reinhard (Reinhard et al., "Photographic tone reproduction", 2002, eq. 4) of the largest channel m:
    m (1 + m / white^2) / (1 + m), all channels by the same factor, so that hues stay; `white` becomes white, dark light
    stays as it is. One curve for a whole sequence: nothing flickers.
    """
    light = (
        to_linear(picture)
        if picture.dtype == np.uint8
        else np.clip(np.nan_to_num(picture.astype(np.float32), nan=0.0, posinf=HALF_MAX), 0.0, HALF_MAX)
    )
    light = light.astype(np.float32) * np.asarray(gain, np.float32)
    m = light.max(axis=2, keepdims=True)
    return np.rint(_encode(np.clip(light * ((1 + m / np.float32(white) ** 2) / (1 + m)), 0.0, 1.0)) * 255.0).astype(
        np.uint8
    )


def to_srgb(light: np.ndarray) -> np.ndarray:
    """Turn linear light into sRGB values 0..255, not rounded; light is clipped to 0..1. The inverse of `to_linear`."""
    return _encode(np.clip(np.asarray(light, dtype=np.float64), 0.0, 1.0)) * 255.0


def gain_table(gain: np.ndarray) -> np.ndarray:
    """[1, 256, 3] uint8: what each sRGB value of each channel becomes when its light is multiplied
    by `gain` [3]; for `cv2.LUT`."""
    linear = np.clip(to_linear(np.arange(256))[:, None] * gain, 0.0, 1.0)
    return np.rint(_encode(linear) * 255.0).astype(np.uint8)[None]


def _encode(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
