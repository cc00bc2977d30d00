"""The mixture of two pictures: the best share there is, and never worse than what there was."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from posegaussian.stages.refinement.judging import mixed

PICTURES = arrays.arrays(np.float32, (3, 2, 4, 3), elements=st.floats(0, 1, width=32))
ROUNDING = 1e-12
"""Sums of 24 squares of at most 1 in float64."""


def error_at(share: float, refined: np.ndarray, unrefined: np.ndarray, truth: np.ndarray) -> float:
    return float(
        np.mean((share * refined.astype(np.float64) + (1 - share) * unrefined.astype(np.float64) - truth) ** 2)
    )


@given(PICTURES)
def test_no_other_share_is_better_and_the_error_is_that_of_the_mixture(pictures: np.ndarray) -> None:
    found = mixed(*pictures)
    assert 0 <= found.share <= 1
    assert abs(found.error - error_at(found.share, *pictures)) <= ROUNDING
    for other in np.linspace(0, 1, 11):
        assert found.error <= error_at(other, *pictures) + ROUNDING


@given(PICTURES, st.floats(0.0, 1.0))
def test_what_was_mixed_is_found_again(pictures: np.ndarray, share: float) -> None:
    refined, unrefined = pictures[0].astype(np.float64) + 1, pictures[1].astype(np.float64)  # apart at every pixel
    truth = share * refined + (1 - share) * unrefined
    found = mixed(refined, unrefined, truth)
    np.testing.assert_allclose(found.share, share, atol=1e-9)  # quotients of sums in float64
    assert found.error <= ROUNDING


def test_no_share_where_refinement_leads_away_or_nowhere() -> None:
    truth, unrefined = np.full((2, 2, 3), 0.25, np.float32), np.full((2, 2, 3), 0.5, np.float32)
    for refined in (unrefined, unrefined + np.float32(0.25)):
        assert mixed(refined, unrefined, truth) == (0.0625, 0.0)
    assert mixed(np.full((2, 2, 3), 0.375, np.float32), unrefined, truth).share == 1, "as far as it leads"
