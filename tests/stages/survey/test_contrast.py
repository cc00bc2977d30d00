"""Whether pictures show anything: noise is nothing, a subject is something wherever it stands in the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.imaging.contrast import contrast
from posegaussian.stages.survey.trust import NOTHING, SOMETHING


def noisy(level: float, sigma: float = 0.0) -> np.ndarray:
    """[200, 160, 3] of one brightness."""
    random = np.random.default_rng(0)
    return np.clip(level + sigma * random.normal(size=(200, 160, 3)), 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("level", [0, 90, 255])
def test_a_picture_of_one_brightness_shows_nothing_however_noisy_it_is(level: float) -> None:
    assert contrast(noisy(level)) == 0
    found = contrast(noisy(level, sigma=12))
    assert found is not None
    # Averages of 81 pixels of three channels, which grey weighs by .3, .59 and .11, scatter by 12 * .67 / 9.
    assert found < NOTHING / 2


def test_what_counts_lies_inside_the_mask() -> None:
    """A capped lens whose picture carries a bright clock, and a dark subject before a bright wall."""
    picture, mask = noisy(0), np.zeros((200, 160), np.uint8)
    mask[40:180, 50:110] = 255
    picture[:30] = 255
    assert contrast(picture, mask) == 0
    whole = contrast(picture)
    assert whole is not None
    assert whole > SOMETHING
    picture[40:110, 50:110] = 120
    found = contrast(picture, mask)
    assert found is not None
    assert found == pytest.approx(120, abs=1)


def test_an_empty_mask_tells_nothing_and_a_thin_one_its_own_pixels() -> None:
    picture = noisy(40)
    picture[:, 80:] = 140
    assert contrast(picture, np.zeros((200, 160), np.uint8)) is None
    thin = np.zeros((200, 160), np.uint8)
    thin[100, 20:140] = 255
    assert contrast(picture, thin) == pytest.approx(100, abs=1)
    assert contrast(picture, np.zeros((20, 16), np.uint8)) == pytest.approx(100, abs=1)


def dressed_in_black(around: float) -> tuple[np.ndarray, np.ndarray]:
    """(picture [200, 160, 3], mask) of a person in plain dark clothes, seen from behind."""
    picture, mask = noisy(around, sigma=1), np.zeros((200, 160), np.uint8)
    cv2.ellipse(mask, (80, 110), (30, 75), 0, 0, 360, 255, -1)
    picture[mask > 0] = noisy(24, sigma=2)[mask > 0]
    return picture, mask


@pytest.mark.parametrize("around", [0, 70, 120, 255])
def test_a_person_in_plain_dark_clothes_shows_something_by_standing_out(around: float) -> None:
    picture, mask = dressed_in_black(around)
    assert np.ptp(np.percentile(picture[mask > 0], [2, 98])) < NOTHING
    found = contrast(picture, mask)
    assert found is not None
    assert found > NOTHING
    assert found == pytest.approx(abs(around - 24), abs=6)  # averages over the outline are a part of what is around


@pytest.mark.parametrize("level", [0, 90, 255])
@pytest.mark.parametrize("sigma", [0, 12])
def test_bars_a_time_stamp_and_a_mask_on_black_make_nothing_of_a_picture_that_shows_nothing(
    level: float, sigma: float
) -> None:
    picture, (_, mask) = noisy(level, sigma), dressed_in_black(0)
    cut_out = np.where(mask[..., None] > 0, picture, 0)
    picture[:34], picture[-12:], picture[165:175, 2:60] = 0, 0, 255 - int(level)
    mask[:34], mask[-12:] = 0, 0
    shown = [picture] if level == 90 else [picture, cut_out]  # a stuck grey that is cut out is a plain grey subject
    for seen in shown:
        found = contrast(seen, mask)
        assert found is not None
        assert found < NOTHING
