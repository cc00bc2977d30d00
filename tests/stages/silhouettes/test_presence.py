"""Frames that show somebody are told from those that show nobody; where nobody comes or goes nothing changes."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.silhouettes.presence import LOOKED_THROUGH, showing, shows_somebody, with_somebody
from posegaussian.storage.model.masks import NEARLY_EMPTY

VIEWS = 6


def test_a_mask_shows_somebody_from_a_few_thousandths_of_the_picture_on() -> None:
    mask = np.zeros((100, 100), np.uint8)
    assert not shows_somebody(mask)
    mask.ravel()[: round(NEARLY_EMPTY * mask.size) - 1] = 255
    assert not shows_somebody(mask)
    mask.ravel()[: round(NEARLY_EMPTY * mask.size)] = 255
    assert shows_somebody(mask)
    assert not shows_somebody(np.full((100, 100), 100, np.uint8)), "less than half of every pixel"


@pytest.mark.parametrize("frames", [1, 2, 10, 1000])
def test_where_the_usual_frames_show_somebody_nothing_else_is_looked_at(frames: int) -> None:
    numbers, asked = np.arange(frames) + 7, list[int]()
    usual = numbers[[frames // 3, (2 * frames) // 3]]

    def seeing(number: int) -> int:
        asked.append(number)
        return VIEWS // 2

    np.testing.assert_array_equal(with_somebody(numbers, usual, seeing, VIEWS), numbers)
    assert set(asked) == set(usual.tolist())


def test_who_is_there_in_some_frames_is_looked_for_in_some_of_all() -> None:
    numbers = np.arange(100)
    found = with_somebody(numbers, numbers[[33, 66]], lambda n: VIEWS * (n >= 50), VIEWS)
    assert (found >= 50).all()
    assert found[-1] == 99
    every = showing(numbers, lambda n: VIEWS)
    assert len(every) == LOOKED_THROUGH
    np.testing.assert_array_equal(found, every[every >= 50])


def test_frames_count_in_which_half_as_many_views_see_somebody_as_in_the_best() -> None:
    counts = [0, 1, 2, 4, 3, 0, 1]
    np.testing.assert_array_equal(showing(range(7), counts.__getitem__), [2, 3, 4])
    np.testing.assert_array_equal(with_somebody(np.arange(7), np.array([2, 4]), counts.__getitem__, VIEWS), [2, 3, 4])


def test_where_nobody_is_found_all_frames_stay() -> None:
    np.testing.assert_array_equal(with_somebody(np.arange(9), np.array([3, 6]), lambda n: 0, VIEWS), np.arange(9))
    assert not len(showing(range(9), lambda n: 0))
    assert not len(showing([], lambda n: 1))
