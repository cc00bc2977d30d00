"""Laws of the rasterizer: analytic values, invariances, gradients by finite differences, threads, tiles, precision."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import torch

from stages.rendering import reference
from stages.rendering.scene import Camera, Cutoffs, Gaussians, Rendering
from tests.stages.rendering.scenes import camera, cloud, draw, gaussians

NO_CUTS = Cutoffs(alpha_min=1e-12, alpha_max=1.0, transmittance_stop=0.0)
SMOOTH = Cutoffs(alpha_min=1e-9, alpha_max=1.0, transmittance_stop=0.0)
"""Without the jumps of the thresholds, so that finite differences see the derivative alone."""


def same(a: Rendering, b: Rendering, tolerance: float = 0.0) -> bool:
    return all(torch.allclose(x, y, rtol=0, atol=tolerance) for x, y in zip(a[:3], b[:3], strict=True))


def plain_loop(g: Gaussians, cam: Camera, cutoffs: Cutoffs) -> np.ndarray:
    """The definition, pixel by pixel in float64 with 2x2 inverses: [h, w, 5]."""
    k, out = cam.intrinsics, np.zeros((cam.height, cam.width, 5))
    order = np.argsort(g.mean[:, 2].numpy(), kind="stable")
    for row in range(cam.height):
        for column in range(cam.width):
            light = 1.0
            for i in order:
                x, y, z = g.mean[i].numpy()
                jacobian = np.array([[k[0, 0] / z, 0, -k[0, 0] * x / z**2], [0, k[1, 1] / z, -k[1, 1] * y / z**2]])
                m = jacobian @ g.rotation[i].numpy() * g.scale[i].numpy()
                d = np.array([column + 0.5 - k[0, 0] * x / z - k[0, 2], row + 0.5 - k[1, 1] * y / z - k[1, 2]])
                alpha = min(cutoffs.alpha_max, float(g.opacity[i]) * np.exp(-0.5 * d @ np.linalg.inv(m @ m.T) @ d))
                if alpha < cutoffs.alpha_min:
                    continue
                if light * (1 - alpha) <= cutoffs.transmittance_stop:
                    break
                out[row, column] += light * alpha * np.array([*g.color[i].numpy(), 1.0, z])
                light *= 1 - alpha
    return out


def test_equals_the_definition_written_as_a_loop() -> None:
    cam, g = camera(13, 9, 14.0), cloud(30)
    out = draw(g, cam)
    picture = torch.cat([out.color, out.alpha[..., None], out.depth[..., None]], dim=2).numpy()
    np.testing.assert_allclose(picture, plain_loop(g, cam, Cutoffs()), atol=1e-12)


@pytest.mark.parametrize(("u", "v", "cx", "cy"), [(24.0, 20.0, 24.0, 20.0), (17.3, 12.8, 24.0, 20.0), (30.25, 9.6, 14.4, 31.0)])
def test_centroid_of_one_gaussian_lies_where_it_projects(u: float, v: float, cx: float, cy: float) -> None:
    """S16, S17: also with the principal point at 0.3 of the width."""
    cam, z = camera(cx=cx, cy=cy), 2.0
    out = draw(gaussians([(u - cx) / 50 * z, (v - cy) / 50 * z, z], scale=0.05), cam, NO_CUTS)
    rows, columns = torch.meshgrid(torch.arange(40) + 0.5, torch.arange(48) + 0.5, indexing="ij")
    total = out.alpha.sum()
    assert abs(float((out.alpha * columns).sum() / total) - u) < 1e-4
    assert abs(float((out.alpha * rows).sum() / total) - v) < 1e-4


def test_profile_and_energy_of_one_gaussian() -> None:
    """Law: alpha = o exp(-d^2 / 2 s^2) with s = f scale / z px, and its sum is 2 pi s^2 o (to the tail cut off at 1e-12)."""
    cam = camera()
    out = draw(gaussians([0, 0, 2.0], scale=0.06, opacity=0.7), cam, NO_CUTS)
    s = 50 * 0.06 / 2
    d2 = (torch.arange(48) + 0.5 - 24) ** 2 + ((torch.arange(40) + 0.5 - 20) ** 2)[:, None]
    torch.testing.assert_close(out.alpha, 0.7 * torch.exp(-d2.double() / (2 * s * s)), atol=1e-11, rtol=0)
    assert abs(float(out.alpha.sum()) - 2 * np.pi * s * s * 0.7) < 1e-6
    torch.testing.assert_close(out.color, out.alpha[..., None] * torch.tensor([1.0, 0.5, 0.25]))
    torch.testing.assert_close(out.depth, 2.0 * out.alpha)


def test_nearer_gaussian_covers_farther_one_in_whatever_order() -> None:
    cam = camera(1, 1, 50.0)
    near, far = [0.0, 0.0, 1.0], [0.0, 0.0, 3.0]
    colors = torch.tensor([[1.0, 0, 0], [0, 0, 1.0]], dtype=torch.float64)
    out = draw(gaussians([near, far], 0.5, 0.6, colors), cam)
    swapped = draw(gaussians([far, near], 0.5, 0.6, colors.flip(0)), cam)
    torch.testing.assert_close(out.color[0, 0], torch.tensor([0.6, 0, 0.4 * 0.6], dtype=torch.float64), atol=1e-12, rtol=0)
    assert same(out, swapped)


def test_permutation_changes_nothing() -> None:
    """Depths differ, so the order of the input must not matter, to the bit."""
    g = cloud(200)
    order = torch.randperm(200, generator=torch.Generator().manual_seed(1))
    shuffled = Gaussians(*(getattr(g, f.name)[order] for f in dataclasses.fields(g)))
    assert same(draw(g, camera()), draw(shuffled, camera()))


def test_equal_depths_are_blended_in_the_order_of_the_input() -> None:
    """S15: ties are broken by index, in every tile."""
    mean = torch.tensor([[0.0, 0, 2.0]]).repeat(5, 1)
    colors = torch.eye(5, 3, dtype=torch.float64)
    out = draw(gaussians(mean, 0.5, 0.5, colors), camera())
    assert out.color[20, 24, 0] > 1.9 * out.color[20, 24, 1] > 3.6 * out.color[20, 24, 2] > 0
    assert same(out, draw(gaussians(mean, 0.5, 0.5, colors), camera()))


def test_background_is_transmittance_times_its_colour() -> None:
    """S18: the picture is premultiplied; a white sheet behind everything adds exactly 1 - alpha."""
    g, cam = cloud(60), camera()
    cut = Cutoffs(alpha_max=1.0, transmittance_stop=-1.0)
    sheet = gaussians([0, 0, 1e3], 1e6, 1.0, (1.0, 1.0, 1.0))
    black, white = draw(g, cam, cut), draw(Gaussians.concatenate([g, sheet]), cam, cut)
    torch.testing.assert_close(white.color, black.color + (1 - black.alpha)[..., None], atol=1e-6, rtol=0)  # the sheet's alpha is exp(-1e-9)
    assert bool((black.color <= black.alpha[..., None] + 1e-12).all())


@pytest.mark.parametrize("name", ["mean", "scale", "opacity", "color", "rotation"])
def test_gradient_equals_finite_differences(name: str) -> None:
    g, cam = cloud(12, seed=3), camera(11, 10, 12.0)
    weights = torch.as_tensor(np.random.default_rng(0).normal(size=(10, 11, 5)))

    def loss(values: torch.Tensor) -> torch.Tensor:
        out = draw(dataclasses.replace(g, **{name: values}), cam, SMOOTH)
        return (torch.cat([out.color, out.alpha[..., None], out.depth[..., None]], dim=2) * weights).sum()

    values = getattr(g, name).clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(values), values)
    rng, step = np.random.default_rng(1), 1e-6
    for _ in range(6):
        direction = torch.as_tensor(rng.normal(size=values.shape))
        with torch.no_grad():
            numeric = (loss(values + step * direction) - loss(values - step * direction)) / (2 * step)
        expected = float((gradient * direction).sum())
        # central differences at 1e-6 in float64: truncation and rounding leave about 1e-8 relative
        assert abs(float(numeric) - expected) < 1e-6 * max(1.0, abs(expected))


@pytest.mark.parametrize("opacity", [0.985, 0.9895, 0.995, 1.0])
def test_gradient_at_the_alpha_cap(opacity: float) -> None:
    """S7, S8: one constant for forward and backward; above the cap the gradient is zero, below it is not."""
    value = torch.tensor([opacity], dtype=torch.float64, requires_grad=True)
    g = dataclasses.replace(gaussians([0, 0, 2.0], 0.5), opacity=value)
    out = draw(g, camera(1, 1))
    out.alpha.sum().backward()
    assert float(out.alpha.detach()) == pytest.approx(min(opacity, 0.99))
    assert float(value.grad) == pytest.approx(1.0 if opacity < 0.99 else 0.0)


def test_gradient_survives_a_tile_in_which_nothing_blends() -> None:
    """A faint Gaussian whose box holds a pixel centre and whose ellipse does not: other tiles keep their gradients."""
    c = np.sqrt(0.5)
    diagonal = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1.0]])
    needle = gaussians([0.205, -0.205, 2.0], [[0.08, 0.0005, 0.0005]], 0.02, rotation=diagonal)
    visible = gaussians([-0.6, 0.4, 2.0], 0.05)
    opacity = torch.tensor([0.02, 0.8], dtype=torch.float64, requires_grad=True)
    both = dataclasses.replace(Gaussians.concatenate([needle, visible]), opacity=opacity)
    draw(both, camera()).alpha.sum().backward()
    alone = torch.tensor([0.8], dtype=torch.float64, requires_grad=True)
    draw(dataclasses.replace(visible, opacity=alone), camera()).alpha.sum().backward()
    assert opacity.grad is not None
    assert opacity.grad[1] == alone.grad[0]


def test_float32_follows_float64() -> None:
    """S20. Thresholds flip for single contributions of 1/255, so the share of pixels beyond 1e-4 is bounded beside the maximum."""
    a, b = draw(cloud(300), camera()), draw(cloud(300, dtype=torch.float32), camera())
    difference = (a.color - b.color).abs().amax(dim=2)
    assert b.color.dtype == torch.float32
    assert float(difference.max()) < 1.5 / 255
    assert float((difference > 1e-4).double().mean()) < 0.01


@pytest.mark.parametrize("tile", [1, 3, 8, 16, 64])
def test_tile_size_of_the_reference_changes_no_bit(tile: int) -> None:
    one, other = (reference.composite(cloud(150), camera(37, 29), Cutoffs(), t)[0] for t in (reference.TILE, tile))
    assert torch.equal(one, other)


@pytest.mark.parametrize("budgets", [(64, 10), (256, 2**22)])
def test_memory_budgets_of_the_reference_change_no_bit(budgets: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    whole = draw(cloud(150), camera())
    monkeypatch.setitem(reference.BATCH_PIXELS, "cpu", budgets[0])
    monkeypatch.setattr(reference, "BATCH_PAIRS", budgets[1])
    assert same(whole, draw(cloud(150), camera()))


def test_threads_of_torch_change_no_bit_of_the_reference() -> None:
    """Float32, and enough Gaussians and pixels that torch would split its work."""
    g, cam = cloud(40_000, dtype=torch.float32), camera(300, 260, 300.0)
    g = dataclasses.replace(g, scale=g.scale * 0.05)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = draw(g, cam, backend="reference")
        torch.set_num_threads(3)
        assert same(one, draw(g, cam, backend="reference"))
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 33), (5, 64)])
def test_any_picture_size(size: tuple[int, int]) -> None:
    """S14."""
    g, cam, cut = cloud(20), camera(*size, focal=20.0), Cutoffs(frustum_margin=1e3)  # the loop knows no frustum
    out = draw(g, cam, cut)
    assert out.color.shape == (size[1], size[0], 3)
    assert out.alpha.shape == out.depth.shape == (size[1], size[0])
    np.testing.assert_allclose(out.alpha.numpy(), plain_loop(g, cam, cut)[..., 3], atol=1e-12)


@pytest.mark.parametrize("make", [lambda: cloud(0), lambda: gaussians([0, 0, -2.0]), lambda: gaussians([50.0, 0, 2.0]), lambda: gaussians([0, 0, 2.0], opacity=0.0)])
def test_nothing_to_see_is_black(make: Callable[[], Gaussians]) -> None:
    """S14: no Gaussian, one behind, one aside, one without opacity."""
    out = draw(make(), camera())
    assert float(out.color.abs().sum() + out.alpha.sum() + out.depth.sum()) == 0
