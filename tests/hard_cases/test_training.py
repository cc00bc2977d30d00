"""The catalogue of training, D5 and L1-L10; tests/stages/network states the definitions."""

import pytest
import torch

from posegaussian.stages.network.losses import render_loss, sequence_loss, ssim_map
from posegaussian.stages.network.model.heads import growth, limited
from tests.hard_cases.cases_training import (
    FAR,
    bad_batch,
    blend_error,
    dead_confidence,
    kept_disparity,
    naive_blend,
    told_by_neighbours,
)


@pytest.mark.parametrize("count", [1, 2, 8])
def test_d5_any_number_of_iterations(count: int) -> None:
    truth = torch.zeros(1, 1, 2, 2)
    found = float(sequence_loss([truth + 1] * count, truth, torch.ones_like(truth), 0.5))
    assert found == pytest.approx(2 - 0.5 ** (count - 1))


def test_l1_the_training_loss_is_never_negative() -> None:
    x = torch.full((1, 1, 32, 32), 0.6)
    assert float(ssim_map(x, x + 1e-7).max()) <= 1
    assert float(render_loss(x, x + 1e-7)) >= 0


def test_l5_every_head_has_a_slope() -> None:
    x = torch.tensor(FAR, requires_grad=True)
    growth(x).sum().backward()
    assert float(x.grad.min()) > 1e-9


def test_l6_l6b_blends_keep_to_one_hemisphere_and_confidence_its_slope() -> None:
    assert blend_error() < 0.2 < naive_blend()
    assert dead_confidence(True) == 0
    assert float(torch.sigmoid(limited(torch.tensor(-1e6)))) > 0.002


def test_l7_pixels_without_a_truth_cost_nothing_in_training() -> None:
    truth = torch.tensor([0.0, 3.0, torch.nan, 5.0]).reshape(1, 1, 2, 2)
    found = sequence_loss([torch.full_like(truth, 4.0)], truth, truth > 0)
    assert float(found) == 1


def test_l8_autocast_moves_no_disparity() -> None:
    assert kept_disparity() == 0


def test_l9_the_variant_with_batch_normalisation_is_frozen_when_it_is_used() -> None:
    assert told_by_neighbours("batch", False) == 0 < told_by_neighbours("batch", True)


def test_l10_a_bad_step_is_counted_and_the_next_one_is_the_next() -> None:
    changed, trainer = bad_batch()
    assert (changed, trainer.skipped, trainer.step) == (0, 1, 1)
