"""The part of a picture that holds something."""

import numpy as np
import pytest

from posegaussian.stages.imaging.part import part_around


@pytest.mark.parametrize("beyond", [0, 1, 5])
@pytest.mark.parametrize("seed", range(4))
def test_all_that_is_there_lies_within_and_no_less_would_do(seed: int, beyond: int) -> None:
    random = np.random.default_rng(seed)
    there = np.zeros((23, 31), bool)
    there[random.integers(0, 23, 3), random.integers(0, 31, 3)] = True
    part = part_around(there, beyond)
    assert there[part].sum() == there.sum()
    rows, columns = np.nonzero(there)
    for side, found, most in zip(part, (rows, columns), there.shape, strict=True):
        kept = np.arange(most)[side]
        assert kept[0] == max(found.min() - beyond, 0)
        assert kept[-1] == min(found.max() + beyond, most - 1)


def test_of_an_empty_picture_there_is_no_part() -> None:
    nothing = np.zeros((5, 7), bool)
    assert nothing[part_around(nothing, 3)].size == 0
