"""High dynamic range and wide gamut, as phones film by default, brought to sRGB by one fixed curve.

Light is decoded by ITU-R BT.2100 (HLG, PQ) and scaled so that reference white (BT.2408: 75 % of an HLG signal, 203
cd/m² of a PQ one) is 1; colours go to BT.709 primaries, and what lies above `KNEE` is brought below white, so that
clothes look as in a video of standard range and lamps keep some shape. Nothing is measured in a picture: all frames and
cameras are treated alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

HLG, PQ = 18, 16
"""Transfer functions, ITU-T H.273, table 3."""
BT709, BT2020, DISPLAY_P3 = 1, 9, 12
"""Primaries, ITU-T H.273, table 2."""
KNEE = 0.8
"""Light, of reference white, from which on it is compressed: white becomes 247 of 255."""
_BRIGHTEST = 4.0
"""Light that counts as white: the brightest of HLG is 3.8 times reference white."""
_STEPS = 65536
_CHROMATICITIES = {
    BT709: ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),
    BT2020: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    DISPLAY_P3: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
_WHITE = (0.3127, 0.3290)
"""D65, of all of them."""


@dataclass(frozen=True)
class WideColor:
    """How a video is encoded that is more than BT.709."""

    transfer: int
    primaries: int

    @classmethod
    def of(cls, transfer: int, primaries: int) -> WideColor | None:
        """By what a file names, ITU-T H.273; None where it is BT.709 or nothing."""
        high = transfer in (HLG, PQ)
        known = primaries if primaries in _CHROMATICITIES else BT2020 if high else BT709
        return cls(transfer if high else 0, known) if high or known != BT709 else None

    @property
    def name(self) -> str:
        """As people call it."""
        gamut = {BT709: "BT.709", BT2020: "BT.2020", DISPLAY_P3: "Display P3"}[self.primaries]
        return {HLG: f"HLG, {gamut}", PQ: f"PQ, {gamut}"}.get(self.transfer, gamut)

    def displayed(self, coded: np.ndarray) -> np.ndarray:
        """[h, w, 3] uint8 sRGB of a picture [h, w, 3] uint16, full range, in this encoding."""
        import cv2

        light = cv2.transform(_light(self.transfer)[coded], _to_bt709(self.primaries))
        steps = np.clip(light, 0, _BRIGHTEST) * np.float32((_STEPS - 1) / _BRIGHTEST)
        return _display(self.transfer in (HLG, PQ))[np.rint(steps).astype(np.uint16)]


@lru_cache
def _light(transfer: int) -> np.ndarray:
    """[65536] float32: light of every code value, of reference white."""
    value = np.linspace(0, 1, _STEPS)
    if transfer == HLG:
        return (_hlg(value) / _hlg(np.array(0.75))).astype(np.float32)
    if transfer == PQ:
        return (_pq(value) / 203).astype(np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _hlg(value: np.ndarray) -> np.ndarray:
    """Scene light 0..1 of signals 0..1: the inverse OETF of BT.2100, table 5."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * np.log(4 * a)
    return np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)


def _pq(value: np.ndarray) -> np.ndarray:
    """Displayed light, cd/m², of signals 0..1: the EOTF of BT.2100, table 4."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
    power = value ** (1 / m2)
    return 10000 * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)


@lru_cache
def _display(high_range: bool) -> np.ndarray:
    """[65536] uint8 sRGB of light 0..`_BRIGHTEST`, compressed above the knee where the range is high."""
    light = np.linspace(0, _BRIGHTEST, _STEPS)
    if high_range:
        over = np.maximum(light - KNEE, 0) / (1 - KNEE)
        light = np.minimum(light, KNEE) + (1 - KNEE) * (1 - np.exp(-over))
    light = np.minimum(light, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


@lru_cache
def _to_bt709(primaries: int) -> np.ndarray:
    """[3, 3] float32 from linear RGB of these primaries to that of BT.709."""
    return (np.linalg.inv(_to_xyz(BT709)) @ _to_xyz(primaries)).astype(np.float32)


def _to_xyz(primaries: int) -> np.ndarray:
    """[3, 3] from linear RGB to XYZ in which white has a luminance of 1."""
    x, y, z = (np.array([(px, py, 1 - px - py) for px, py in _CHROMATICITIES[primaries]]).T[i] for i in range(3))
    columns = np.stack([x, y, z]) / y
    white = np.array([_WHITE[0] / _WHITE[1], 1.0, (1 - sum(_WHITE)) / _WHITE[1]])
    return columns * np.linalg.solve(columns, white)
