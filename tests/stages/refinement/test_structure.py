"""D-SSIM: its definition is the metrics', its gradient is that of its value."""

import numpy as np
import torch

from posegaussian.stages.metrics.measures.ssim import ssim_map
from posegaussian.stages.refinement.structure import dissimilarity

H, W = 36, 40


def pictures() -> tuple[torch.Tensor, torch.Tensor]:
    """A patch on black, and the same with noise: outside the window the border's treatment has no say."""
    random = np.random.default_rng(3)
    truth = np.zeros((H, W, 3), np.float32)
    truth[12:24, 12:28] = random.uniform(0.2, 0.8, (12, 16, 3))
    noise = np.zeros_like(truth)
    noise[12:24, 12:28] = random.normal(0, 0.1, (12, 16, 3))
    return torch.from_numpy(truth + noise), torch.from_numpy(truth)


def test_equal_pictures_cost_nothing_and_have_no_gradient() -> None:
    _, truth = pictures()
    given = truth.clone().requires_grad_(True)
    value = dissimilarity(given, truth, torch.ones(H, W))
    value.backward()
    assert abs(value.item()) < 1e-4
    assert given.grad is not None
    # at the maximum of SSIM the gradient vanishes; what is left is float32 rounding over variances of about C2
    assert float(given.grad.abs().max()) < 1e-3


def test_it_is_the_metrics_ssim() -> None:
    given, truth = pictures()
    expected = (1 - ssim_map(given.numpy().astype(np.float64), truth.numpy().astype(np.float64), 1.0)) / 2
    np.testing.assert_allclose(float(dissimilarity(given, truth, torch.ones(H, W))), expected.sum(), rtol=1e-3)


def test_the_gradient_is_the_slope_of_the_value() -> None:
    given, truth = pictures()
    random = np.random.default_rng(5)
    weight = torch.from_numpy(random.uniform(0, 1, (H, W)).astype(np.float32))
    given.requires_grad_(True)
    dissimilarity(given, truth, weight).backward()
    assert given.grad is not None
    direction = torch.zeros(H, W, 3)
    direction[12:24, 12:28] = torch.from_numpy(random.normal(0, 1, (12, 16, 3)).astype(np.float32))
    with torch.no_grad():
        step = 1e-3
        up, down = (float(dissimilarity(given + s * step * direction, truth, weight)) for s in (1, -1))
    np.testing.assert_allclose(float((given.grad * direction).sum()), (up - down) / (2 * step), rtol=0.01)


def test_what_both_pictures_leave_black_adds_nothing() -> None:
    given, truth = pictures()
    wide = [torch.nn.functional.pad(t, (0, 0, 0, 50, 0, 30)) for t in (given, truth)]
    np.testing.assert_allclose(
        float(dissimilarity(wide[0], wide[1], torch.ones(H + 30, W + 50))),
        float(dissimilarity(given, truth, torch.ones(H, W))),
        rtol=1e-6,
    )


def test_empty_pictures_cost_nothing() -> None:
    empty = torch.zeros(H, W, 3, requires_grad=True)
    value = dissimilarity(empty, torch.zeros(H, W, 3), torch.ones(H, W))
    value.backward()
    assert value.item() == 0.0
    assert empty.grad is not None
    assert not empty.grad.any()
