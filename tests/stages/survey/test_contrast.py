"""Whether pictures show anything: noise is nothing, a subject is something wherever it stands in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.survey.algorithms.light import contrast
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
