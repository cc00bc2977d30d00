"""The numerical catalogue of splatting (S1, S2, S3, S5, S6, S7, S10, S12, S13): finite in value and gradient, always."""

import dataclasses

import numpy as np
import pytest
import torch

from stages.rendering.projection import project
from stages.rendering.scene import Cutoffs, Gaussians
from tests.stages.rendering.scenes import camera, cloud, draw, gaussians, turned_about_y

FIELDS = [f.name for f in dataclasses.fields(Gaussians)]


def finite_with_gradient(g: Gaussians, **options: object) -> torch.Tensor:
    """The alpha picture, after checking that every output and every gradient is finite."""
    leaves = {name: getattr(g, name).clone().requires_grad_() for name in FIELDS}
    out = draw(Gaussians(**leaves), camera(), **options)  # type: ignore[arg-type]
    for part in out[:3]:
        assert torch.isfinite(part).all()
    (out.color.sum() + out.alpha.sum() + out.depth.sum()).backward()
    for name, leaf in leaves.items():
        assert leaf.grad is None or torch.isfinite(leaf.grad).all(), name
    return out.alpha.detach()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("z", "seen"), [(-1.0, False), (0.0, False), (1e-6, False), (0.01, False), (0.0101, True), (0.2, True)])
def test_s1_near_plane(z: float, seen: bool, dtype: torch.dtype) -> None:
    alpha = finite_with_gradient(gaussians([0, 0, z], 0.01, dtype=dtype))
    assert bool(alpha.any()) == seen


def test_s2_means_outside_the_frustum_do_not_smear() -> None:
    """Unclamped, the affine approximation stretches like 1/cos^2 and a ball at 89 degrees crosses the whole picture."""
    for degrees in (0, 20, 40, 60, 70, 80, 85, 89):
        direction = np.radians(degrees)
        alpha = finite_with_gradient(gaussians([2 * np.sin(direction), 0, 2 * np.cos(direction)], 0.05))
        assert float(alpha.max()) <= 0.8
        if degrees >= 60:
            assert not alpha.any()
    wide = gaussians([3.0, 0, 0.3], 0.2)
    assert not finite_with_gradient(wide).any()
    assert finite_with_gradient(wide, cutoffs=Cutoffs(frustum_margin=1e3)).any()  # the smear that the limit prevents


def test_s2_limits_follow_the_principal_point() -> None:
    """Mirroring scene and principal point mirrors the picture."""
    g = gaussians([[0.9, 0.1, 1.0], [-0.2, 0, 1.0]], 0.1)
    mirrored = dataclasses.replace(g, mean=g.mean * torch.tensor([-1.0, 1, 1]))
    right, left = draw(g, camera(cx=14.4)), draw(mirrored, camera(cx=48 - 14.4))
    torch.testing.assert_close(right.alpha, left.alpha.flip(1), atol=1e-12, rtol=0)


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-6, 1e-3])
@pytest.mark.parametrize("low_pass", [0.0, 0.3])
def test_s3_subpixel_gaussians(scale: float, low_pass: float) -> None:
    g = gaussians([0.01, 0.005, 2.0], scale)
    alpha = finite_with_gradient(g, cutoffs=Cutoffs(low_pass=low_pass))
    p = project(g, camera(), Cutoffs(low_pass=low_pass))
    assert torch.isfinite(p.whitening).all()
    if low_pass:  # variances add; the cut at 1/255 takes 0.5 % of the energy, sampling at 0.55 px sigma 1 %
        assert float(alpha.sum()) == pytest.approx(2 * np.pi * (0.3 + (25 * scale) ** 2) * 0.8, rel=0.02)


@pytest.mark.parametrize("ratio", [1.0, 1e2, 1e4, 1e6])
def test_s5_needles(ratio: float) -> None:
    """The determinant is a squared length: positive in float32 as well, and close to float64's."""
    rotation = turned_about_y(30) @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])
    scale = [[0.5, 0.5 / ratio, 0.5 / ratio]]
    g64 = gaussians([0.1, 0.05, 2.0], scale, rotation=rotation)
    g32 = gaussians([0.1, 0.05, 2.0], scale, rotation=rotation, dtype=torch.float32)
    p64, p32 = (project(g, camera(), Cutoffs()) for g in (g64, g32))
    assert len(p64.depth) == len(p32.depth)
    if len(p64.depth):
        area = [float(p.whitening.double()[0, [0, 3]].prod() - p.whitening.double()[0, [1, 2]].prod()) for p in (p64, p32)]
        # a cross product of nearly parallel float32 rows loses the digits of the ratio; the square of it would lose all at 1e4
        assert abs(area[1] / area[0]) == pytest.approx(1, rel=max(1e-5, 2e-7 * ratio))
    finite_with_gradient(g64)
    finite_with_gradient(g32)


def test_s6_no_alpha_above_its_opacity() -> None:
    g = dataclasses.replace(cloud(200, dtype=torch.float32), opacity=torch.full((200,), 0.3))
    for i in range(0, 200, 20):
        one = Gaussians(*(getattr(g, name)[i : i + 1] for name in FIELDS))
        assert float(draw(one, camera()).alpha.max()) <= np.float32(0.3)


def test_s7_a_stack_of_opaque_gaussians() -> None:
    """Two contributions of 0.99 leave a transmittance of 1e-4, which drops the second: (1 - cap)^2 is the stop."""
    z = torch.linspace(1, 2, 100, dtype=torch.float64)
    g = gaussians(torch.stack([z * 0, z * 0, z], dim=1), 10.0, 1.0)
    alpha = finite_with_gradient(g)
    assert float(alpha.min()) >= 0.99
    assert float(alpha.max()) < 1


@pytest.mark.parametrize(("opacity", "seen"), [(0.0, False), (1e-9, False), (1 / 255 - 1e-6, False), (1 / 255 + 1e-6, True)])
def test_s10_smallest_alpha(opacity: float, seen: bool) -> None:
    cam_centre = gaussians([0.02, 0.02, 2.0], 0.5, opacity)  # half a pixel: exactly on a pixel centre
    assert bool(finite_with_gradient(cam_centre).any()) == seen


def test_s12_huge_scales() -> None:
    alpha = finite_with_gradient(gaussians([[0, 0, 2.0], [0.3, 0, 3.0]], 1e3, 0.5, dtype=torch.float32))
    torch.testing.assert_close(alpha, torch.full_like(alpha, 0.75), atol=1e-4, rtol=0)
    finite_with_gradient(gaussians([0, 0, 2.0], 1e30, dtype=torch.float32))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", FIELDS)
def test_s13_not_finite_is_masked_and_counted(name: str, bad: float) -> None:
    g = cloud(20)
    poisoned = dataclasses.replace(g, **{name: getattr(g, name).clone()})
    getattr(poisoned, name)[7, ...] = bad
    rest = [i for i in range(20) if i != 7]
    clean = draw(Gaussians(*(getattr(g, n)[rest] for n in FIELDS)), camera())
    out = draw(poisoned, camera())
    assert out.masked == 1
    assert torch.equal(out.color, clean.color)
    finite_with_gradient(poisoned)
