"""Laws of both back ends: the definition as a loop, analytic values, finite differences;
threads and tiles. Hard cases: tests/hard_cases."""

import dataclasses

import numpy as np
import pytest
import torch

from benchmarks.renderer.workloads import person
from posegaussian.stages.splatting.definition import reference
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians, Rendering
from tests.support.gaussian_scenes import camera, cloud, draw, gaussians

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


@pytest.mark.parametrize(("dtype", "bound"), [(torch.float64, 1e-12), (torch.float32, 2e-6)])
def test_equals_the_definition_written_as_a_loop(dtype: torch.dtype, bound: float) -> None:
    cam, g = camera(13, 9, 14.0), cloud(30)
    out = draw(Gaussians(*(getattr(g, f.name).to(dtype) for f in dataclasses.fields(g))), cam)
    picture = torch.cat([out.color, out.alpha[..., None], out.depth[..., None]], dim=2).numpy()
    np.testing.assert_allclose(picture, plain_loop(g, cam, Cutoffs()), atol=bound)


def test_profile_and_energy_of_one_gaussian() -> None:
    """Law: alpha = o exp(-d^2 / 2 s^2) with s = f scale / z px,
    and its sum is 2 pi s^2 o (to the tail cut off at 1e-12)."""
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
    torch.testing.assert_close(
        out.color[0, 0], torch.tensor([0.6, 0, 0.4 * 0.6], dtype=torch.float64), atol=1e-12, rtol=0
    )
    assert same(out, swapped)


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


@pytest.mark.parametrize("tile", [1, 3, 8, 16, 64])
def test_tile_size_of_the_reference_changes_no_bit(tile: int) -> None:
    one, other = (reference.composite(cloud(150), camera(37, 29), Cutoffs(), t)[0] for t in (reference.TILE, tile))
    assert torch.equal(one, other)


@pytest.mark.parametrize("budgets", [(64, 10), (256, 2**22)])
def test_memory_budgets_of_the_reference_change_no_bit(
    budgets: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_full_size_person_has_the_gradients_of_the_reference_in_float32() -> None:
    """144,000 pixel-aligned Gaussians whose silhouettes hold what random scenes do not."""
    g, cam = person(512)
    rng = np.random.default_rng(0)
    up = [torch.as_tensor(rng.normal(size=s), dtype=torch.float32) for s in ((512, 512, 3), (512, 512))]
    found = []
    for backend in ("cpu", "reference"):
        leaves = [getattr(g, f.name).clone().requires_grad_() for f in dataclasses.fields(g)]
        out = draw(Gaussians(*leaves), cam, backend=backend, extras=())
        found.append((out, torch.autograd.grad([out.color, out.alpha], leaves, up)))
    (a, da), (b, db) = found
    assert float((a.color - b.color).detach().abs().mean()) < 1e-7
    for x, y in zip(da, db, strict=True):
        assert float((x - y).norm() / y.norm()) < 2e-4
