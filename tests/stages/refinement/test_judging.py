"""The mixture of two pictures: the best share there is, and what is made of it."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from posegaussian.stages.refinement.judging import USUAL, Judge, Judgement, best_share, error_of, settled
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians

PICTURES = arrays.arrays(np.float32, (3, 2, 4, 3), elements=st.floats(0, 1, width=32))
ROUNDING = 1e-12
"""Sums of 24 squares of at most 4 in float64."""


@given(PICTURES)
def test_no_other_share_is_better(pictures: np.ndarray) -> None:
    share = best_share(*pictures)
    assert 0 <= share <= 1
    for other in np.linspace(0, 1, 11):
        assert error_of(share, *pictures) <= error_of(other, *pictures) + ROUNDING


@given(PICTURES, st.floats(0.0, 1.0))
def test_what_was_mixed_is_found_again(pictures: np.ndarray, share: float) -> None:
    refined, unrefined = pictures[0].astype(np.float64) + 1, pictures[1].astype(np.float64)  # apart at every pixel
    truth = share * refined + (1 - share) * unrefined
    np.testing.assert_allclose(best_share(refined, unrefined, truth), share, atol=1e-9)  # quotients of sums in float64
    assert error_of(share, refined, unrefined, truth) <= ROUNDING


def test_no_share_where_refinement_leads_away_or_nowhere() -> None:
    truth, unrefined = np.full((2, 2, 3), 0.25, np.float32), np.full((2, 2, 3), 0.5, np.float32)
    for refined in (unrefined, unrefined + np.float32(0.25)):
        assert best_share(refined, unrefined, truth) == 0
        assert error_of(0.0, refined, unrefined, truth) == 0.0625
    assert best_share(np.full((2, 2, 3), 0.375, np.float32), unrefined, truth) == 1, "as far as it leads"


@given(PICTURES)
def test_what_is_settled_on_keeps_half_of_the_judges_gain(pictures: np.ndarray) -> None:
    """Three quarters where the best share is no bound, and more than half where the pictures end before it."""
    best = best_share(*pictures)
    share = settled(best)
    none, found, least = (error_of(s, *pictures) for s in (0.0, share, best))
    assert 0 <= share <= 1
    assert none - found >= 0.5 * (none - least) - ROUNDING


def test_it_grows_with_the_judges_share_and_is_none_without_it() -> None:
    found = [settled(s) for s in np.linspace(0, 1, 21)]
    assert found[0] == 0
    assert (np.diff(found) > 0).all()
    assert settled(USUAL) == pytest.approx(USUAL)


def test_what_the_judges_mask_may_lack_is_not_judged() -> None:
    """Whatever the photograph has there; anywhere else it counts."""
    random = np.random.default_rng(4)
    truth, unrefined = (random.random((12, 10, 3)).astype(np.float32) for _ in range(2))
    lacking, cover = np.zeros((12, 10), bool), np.ones((12, 10), np.float32)
    lacking[7:] = True
    gaussian = Gaussians(
        *(torch.tensor(a) for a in ([[0.0, 0, 2]], [np.eye(3).tolist()], [[0.3] * 3], [0.9], [[0.2, 0.5, 0.7]]))
    )
    camera = Camera(np.array([[12.0, 0, 5], [0, 12, 6], [0, 0, 1]]), np.eye(4), 10, 12)

    def judged(picture: np.ndarray) -> tuple[float, Judgement]:
        judge = Judge(Filmed(camera, picture, cover, lacking), unrefined)
        return judge.before, judge.judgement(lambda: gaussian)

    there, elsewhere = truth.copy(), truth.copy()
    there[lacking], elsewhere[2] = 0, 0
    assert judged(there) == judged(truth)
    assert judged(elsewhere) != judged(truth)
