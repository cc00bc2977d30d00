"""Hard cases of the matching network's correlation, coordinates and depth coding;
the catalogue's own test holds their bounds."""

import math

import pytest
import torch

from posegaussian.stages.network.model.correlation import Correlation, columns_of
from posegaussian.stages.network.model.disparity import Coding
from tests.hard_cases.cases_network import CASES, WIDTHS, gone, loud, random
from tests.hard_cases.catalogue import run


def found(name: str) -> float:
    """The naive version's error."""
    return run(next(c for c in CASES if c.name == name)).naive


def test_d2b_bfloat16_is_a_column_off_where_512_are_and_an_eighth_where_64_are() -> None:
    assert found("D2b") >= 0.9
    disparity = torch.linspace(0.3, 3.7, 64)
    near = (torch.arange(64).bfloat16() - disparity.bfloat16()).float() - (torch.arange(64) - disparity)
    assert 0.1 < float(near.abs().max()) < 0.2
    assert columns_of(disparity.reshape(1, 1, 1, 64).half()).dtype == torch.float32


@pytest.mark.parametrize("scale", [3000.0, -3000.0])
def test_d3b_d10b_depth_is_monotonous_up_to_its_bounds_and_gradients_are_finite(scale: float) -> None:
    disparity, code = gone(scale)
    finite = disparity[torch.isfinite(disparity)].reshape(1, 1, 1, -1).requires_grad_()
    depth = code.depth(finite)
    steps = depth.detach().diff() * (-1 if scale > 0 else 1)
    assert (steps >= 0).all()
    depth.sum().backward()
    assert finite.grad is not None
    assert torch.isfinite(finite.grad).all()
    assert found("D3b") > 1e11
    assert found("D10b") > 0


def test_d3b_a_pair_without_baseline_or_depth_is_refused() -> None:
    good = {"scale": 1.0, "offset": 0.0, "near": 1.0, "far": 2.0}
    for name, bad in (("scale", 0.0), ("near", 0.0), ("far", 1.0), ("far", math.inf), ("offset", math.nan)):
        with pytest.raises(ValueError):
            Coding(**{k: torch.tensor([v], dtype=torch.float64) for k, v in (good | {name: bad}).items()})


def test_d6_the_naive_product_is_infinite_and_ours_peaks_where_it_should() -> None:
    assert not math.isfinite(found("D6"))
    first, second = loud()
    assert (Correlation(first, second, 1, 3).look_up(columns_of(torch.zeros(1, 1, 2, 16))).argmax(1) == 3).all()


@pytest.mark.parametrize("width", WIDTHS)
def test_d7_d8_d9b_both_ways_of_making_products_agree_at_any_width(width: int) -> None:
    first, second = random(1, 6, 2, width), random(1, 6, 2, width, seed=1)
    columns = 3 * width * (random(1, 1, 2, width, seed=2) / 2)
    volume, made = (Correlation(first, second, 4, 4, budget).look_up(columns) for budget in (2**24, 0))
    assert volume.shape == made.shape == (1, 36, 2, width)
    assert torch.isfinite(volume).all()
    torch.testing.assert_close(volume, made, rtol=0, atol=5e-6)  # sums of six products in another order


def test_d12b_d11b_the_naive_versions_miss_by_the_rim_and_by_half_a_cell() -> None:
    assert found("D12b") > 10
    assert found("D11b") == pytest.approx(3.5, abs=1e-4)  # (2^3 - 1) / 2 columns
