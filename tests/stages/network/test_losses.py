"""Laws of the losses: definitions, finite differences, empty masks, and a pose loss that cannot collapse."""

import numpy as np
import pytest
import torch

from posegaussian.stages.metrics.measures.ssim import ssim_map as measured
from posegaussian.stages.network.losses import (
    FAINT,
    PoseFusion,
    effective_rank,
    heatmap_probe,
    masked_mean,
    render_loss,
    sequence_loss,
    ssim_map,
    standardised,
)

torch.set_num_threads(1)


def drawn(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


@pytest.mark.parametrize("size", [(20, 31), (4, 7), (1, 1)])
def test_ssim_is_the_one_that_is_measured(size: tuple[int, int]) -> None:
    x, y = drawn(1, 3, *size), drawn(1, 3, *size, seed=1)
    expected = measured(x[0].permute(1, 2, 0).numpy(), y[0].permute(1, 2, 0).numpy(), 1.0)
    np.testing.assert_allclose(ssim_map(x, y)[0].mean(dim=0).numpy(), expected, atol=1e-9)


@pytest.mark.parametrize("level", [0.0, 1e-3, 0.6, 1.0])
def test_ssim_of_nearly_constant_pictures_is_at_most_1_and_its_gradient_finite(level: float) -> None:
    x = torch.full((1, 1, 32, 32), level)
    y = (x + 1e-7 * torch.randn(x.shape, generator=torch.Generator().manual_seed(3))).requires_grad_()
    found = ssim_map(y, x)
    found.sum().backward()
    # differences of 1e-7 beside c2 = 9e-4 move SSIM by 1e-11; float32 keeps 1e-6 of its means
    assert float((found.detach() - 1).abs().max()) < 1e-6
    assert torch.isfinite(y.grad).all()


@pytest.mark.parametrize("masked", [False, True])
def test_render_gradients_are_those_of_finite_differences(masked: bool) -> None:
    truth, picture = drawn(1, 2, 6, 7), drawn(1, 2, 6, 7, seed=1).requires_grad_()
    mask = drawn(1, 1, 6, 7, seed=2) > 0.5 if masked else None
    assert torch.autograd.gradcheck(lambda p: render_loss(p, truth, mask), picture)


def test_render_is_beta_mae_and_gamma_dissimilarity() -> None:
    x, y = drawn(1, 3, 12, 12), drawn(1, 3, 12, 12, seed=1)
    expected = 0.3 * (x - y).abs().mean() + 0.7 * (1 - ssim_map(x, y)).mean()
    torch.testing.assert_close(render_loss(x, y, None, 0.3, 0.7), expected)
    assert float(render_loss(x, x)) == pytest.approx(0, abs=1e-12)


def test_render_is_float32_within_autocast() -> None:
    x, y = drawn(1, 3, 12, 12, dtype=torch.float32), drawn(1, 3, 12, 12, seed=1, dtype=torch.float32)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(render_loss(x, y), render_loss(x.clone(), y.clone()))
        assert render_loss(x.bfloat16(), y.bfloat16()).dtype == torch.float32


@pytest.mark.parametrize("garbage", [0.0, float("nan"), float("inf")])
def test_an_empty_mask_costs_0_and_has_a_gradient_of_0(garbage: float) -> None:
    truth = torch.full((1, 3, 8, 8), garbage)
    nothing = torch.zeros(1, 1, 8, 8)
    x = drawn(1, 3, 8, 8, dtype=torch.float32).requires_grad_()
    f = drawn(1, 8, 4, 4, dtype=torch.float32).requires_grad_()
    fusion = PoseFusion(8, 8, 3)
    terms = fusion(f, f, drawn(1, 3, 8, 8, dtype=torch.float32), nothing[..., ::2, ::2])
    losses = (render_loss(x, truth, nothing), sequence_loss([x[:, :1], x[:, 1:2]], truth[:, :1], nothing), *terms)
    assert [float(v.detach()) for v in losses] == [0.0] * 4
    sum(losses).backward()
    assert not x.grad.any()
    assert not f.grad.any()


def test_what_lies_outside_the_mask_does_not_matter() -> None:
    values, mask = drawn(1, 1, 5, 5), drawn(1, 1, 5, 5, seed=1) > 0.5
    spoilt = torch.where(mask, values, torch.nan)
    torch.testing.assert_close(masked_mean(spoilt, mask), values[mask].mean())
    mixed = sequence_loss([values], spoilt + 1, torch.ones_like(mask))  # pixels without a truth never count
    torch.testing.assert_close(mixed, torch.tensor(1.0, dtype=torch.float64))


@pytest.mark.parametrize("iterations", [1, 2, 7])
def test_a_sequence_weighs_late_predictions_more(iterations: int) -> None:
    truth, everywhere = torch.zeros(1, 1, 3, 3), torch.ones(1, 1, 3, 3)
    found = sequence_loss([torch.full_like(truth, float(t)) for t in range(1, iterations + 1)], truth, everywhere, 0.9)
    assert float(found) == pytest.approx(sum(0.9 ** (iterations - t) * t for t in range(1, iterations + 1)), rel=1e-6)


def test_sequence_gradients_are_those_of_finite_differences_and_no_prediction_is_refused() -> None:
    predictions = [drawn(1, 1, 3, 4, seed=s).requires_grad_() for s in range(3)]
    assert torch.autograd.gradcheck(
        lambda *p: sequence_loss(p, torch.ones(1, 1, 3, 4).double() / 2, drawn(1, 1, 3, 4, seed=9) > 0.3), predictions
    )
    with pytest.raises(ValueError, match="at least 1 iteration"):
        sequence_loss([], torch.zeros(1, 1, 2, 2), torch.ones(1, 1, 2, 2))


def test_the_pose_side_gets_no_gradient_from_the_alignment() -> None:
    fusion = PoseFusion(6, 8, 3)
    joint, pose = (drawn(2, c, 4, 4, seed=c, dtype=torch.float32).requires_grad_() for c in (6, 8))
    terms = fusion(joint, pose, drawn(2, 3, 16, 16, dtype=torch.float32))
    terms.alignment.backward()
    assert pose.grad is None
    assert bool(joint.grad.any())
    terms.heatmaps.backward()
    assert not pose.grad.any()  # the reader begins at 0, and learns first
    assert bool(fusion.reader.weight.grad.any())
    torch.nn.init.ones_(fusion.reader.weight)
    fusion(joint, pose, drawn(2, 3, 16, 16, dtype=torch.float32)).heatmaps.backward()
    assert bool(pose.grad.any())


def test_unread_heatmaps_cost_1_and_faint_ones_less() -> None:
    """The error is a share of the heatmaps' own squares, or of `FAINT`:
    crops that show hardly a joint are no louder than others."""
    fusion, f, maps = (
        PoseFusion(6, 6, 3),
        drawn(1, 6, 4, 4, dtype=torch.float32),
        drawn(1, 3, 4, 4, seed=1, dtype=torch.float32),
    )
    power = float((maps**2).mean())
    for scale in (1.0, 0.1, 1e-2, 0.0):
        expected = scale**2 * power / max(scale**2 * power, FAINT)
        assert float(fusion(f, f, scale * maps).heatmaps.detach()) == pytest.approx(expected, rel=1e-5)


def test_constant_features_have_a_bounded_gradient() -> None:
    x = torch.ones(1, 8, 3, 3, requires_grad=True)
    (standardised(x) * torch.randn(x.shape, generator=torch.Generator().manual_seed(0))).sum().backward()
    assert float(x.grad.abs().max()) < 1000  # F.normalize: 1e12


def test_rank_and_probe_know_what_features_hold() -> None:
    maps = drawn(1, 4, 20, 20)
    basis = torch.linalg.qr(drawn(8, 8, seed=1))[0]
    full = torch.einsum("ij,bjhw->bihw", basis, torch.cat([maps, drawn(1, 4, 20, 20, seed=2)], dim=1))
    assert effective_rank(full) > 7.5
    assert heatmap_probe(full, maps) == pytest.approx(1, abs=1e-4)
    one = basis[None, :, :1, None] * drawn(1, 1, 20, 20, seed=3)
    assert effective_rank(one) == pytest.approx(1, abs=1e-3)
    assert heatmap_probe(one, maps) < 0.05
    assert effective_rank(torch.ones(1, 8, 20, 20)) == 0
    assert heatmap_probe(torch.ones(1, 8, 20, 20), maps) < 0.05
    nothing = torch.zeros(1, 1, 20, 20)
    assert effective_rank(full, nothing) == heatmap_probe(full, maps, nothing) == 0


def people(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Heatmaps [4, 5, 12, 12] of five joints and pictures [4, 3, 12, 12] that show something else beside them."""
    g = torch.Generator().manual_seed(seed)
    centre = 2 + 8 * torch.rand(4, 5, 2, 1, 1, generator=g)
    grid = torch.stack(torch.meshgrid(torch.arange(12.0), torch.arange(12.0), indexing="ij"))
    heatmaps = torch.exp(-((grid - centre) ** 2).sum(dim=2) / 4)
    return heatmaps, torch.rand(4, 3, 12, 12, generator=g)


def optimised(ours: bool, steps: int = 60) -> tuple[float, float, float, float]:
    """Effective rank and probe of f_pose before and after some steps of the pose loss alone."""
    torch.manual_seed(1)
    heatmaps, picture = people()
    encode = torch.nn.Sequential(torch.nn.Conv2d(5, 16, 3, padding=1), torch.nn.ReLU(), torch.nn.Conv2d(16, 16, 1))
    join = torch.nn.Conv2d(3 + 5, 16, 3, padding=1)
    fusion = PoseFusion(16, 16, 5)
    optimiser = torch.optim.Adam([*encode.parameters(), *join.parameters(), *fusion.parameters()], lr=0.02)
    start = encode(heatmaps)
    for _ in range(steps):
        f_pose, f_joint = encode(heatmaps), join(torch.cat([picture, heatmaps], dim=1))
        loss = sum(fusion(f_joint, f_pose, heatmaps)) if ours else (f_joint - f_pose).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    end = encode(heatmaps)
    return effective_rank(start), effective_rank(end), heatmap_probe(start, heatmaps), heatmap_probe(end, heatmaps)


def test_the_plain_pose_loss_collapses_and_ours_does_not() -> None:
    """What need not be lost is one direction a joint:
    five heatmaps, so a rank of 5 of the 16 channels' 9.8 at the start."""
    before, plain, _, plain_probe = optimised(ours=False)
    _, kept, start_probe, kept_probe = optimised(ours=True)
    assert plain < 0.5 * before
    assert plain_probe < 0.3
    assert kept > 5
    assert kept_probe > start_probe > 0.8
