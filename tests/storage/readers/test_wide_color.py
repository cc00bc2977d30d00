"""High dynamic range and wide gamut as sRGB: what has a counterpart there comes out as it, the rest in order."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.storage.readers.wide_color import BT709, BT2020, DISPLAY_P3, HLG, KNEE, PQ, WideColor

FROM_BT709 = {
    BT709: np.eye(3),
    # ITU-R BT.2087, and of Display P3 the inverse of what CSS Color 4 has, both rounded
    BT2020: np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]),
    DISPLAY_P3: np.array([[0.8225, 0.1775, 0.0], [0.0332, 0.9668, 0.0], [0.0171, 0.0724, 0.9105]]),
}
ENCODINGS = [(t, p) for t in (HLG, PQ, 1) for p in (BT2020, DISPLAY_P3)]


def linear(srgb: np.ndarray) -> np.ndarray:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def encoded(light: np.ndarray, transfer: int) -> np.ndarray:
    """[...] uint16 of light, of reference white: OETF of HLG (BT.2100), inverse EOTF of PQ, and sRGB."""
    if transfer == HLG:
        scene = light * (np.exp((0.75 - 0.55991073) / 0.17883277) + 0.28466892) / 12
        value = np.where(
            scene <= 1 / 12,
            np.sqrt(3 * scene),
            0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073,
        )
    elif transfer == PQ:
        power = (light * 203 / 10000) ** 0.1593017578125
        value = ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    else:
        value = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(65535 * np.clip(value, 0, 1)).astype(np.uint16)


def of(transfer: int, primaries: int) -> WideColor:
    found = WideColor.of(transfer, primaries)
    assert found is not None
    return found


@pytest.mark.parametrize(("transfer", "primaries"), ENCODINGS)
def test_colours_below_the_knee_come_out_as_they_were(transfer: int, primaries: int) -> None:
    """To a level: their matrices have four digits."""
    srgb = np.random.default_rng(0).uniform(0, 1, (40, 30, 3))
    light = linear(srgb)
    there = np.clip(light @ FROM_BT709[primaries].T, 0, None)
    shown = of(transfer, primaries).displayed(encoded(there, transfer))
    below = (light < KNEE) if transfer != 1 else np.ones(light.shape, bool)
    assert np.abs(shown.astype(float) - 255 * srgb)[below].max() <= 1.0


@pytest.mark.parametrize(("transfer", "primaries"), ENCODINGS)
def test_grey_stays_grey_and_more_light_is_never_darker(transfer: int, primaries: int) -> None:
    grey = np.repeat(np.arange(65536, dtype=np.uint16)[:, None, None], 3, axis=2)
    shown = of(transfer, primaries).displayed(grey).astype(int)[:, 0]
    assert np.ptp(shown, axis=1).max() <= 1
    assert (np.diff(shown, axis=0) >= 0).all()
    assert shown[0].tolist() == [0] * 3
    assert shown[-1].tolist() == [255] * 3


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_reference_white_is_nearly_white_and_keeps_what_is_brighter_apart(transfer: int) -> None:
    light = np.array([1.0, 2.0]).reshape(2, 1, 1) * np.ones(3)
    white, brighter = of(transfer, BT2020).displayed(encoded(light, transfer))[:, 0, 0].astype(int)
    assert white == 247
    assert 250 < brighter <= 255


def test_what_is_standard_is_let_be() -> None:
    for transfer in (1, 2, 6, 13):
        for primaries in (1, 2, 5, 6):
            assert WideColor.of(transfer, primaries) is None
    assert of(HLG, 2).name == "HLG, BT.2020"
    assert of(1, DISPLAY_P3).name == "Display P3"
