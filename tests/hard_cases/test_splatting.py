"""The catalogue of splatting, S1-S22:
each case on the compiled back end in float32 against the reference in float64."""

import dataclasses

import numpy as np
import pytest
import torch

from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.splatting.definition.projection import project
from posegaussian.stages.splatting.definition.scene import Cutoffs, Gaussians
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.stages.splatting.splat_scene import scene_of
from tests.hard_cases.laws import FIELDS, agree, derivative, drawn, pictures, to
from tests.storage.formats.test_splat_files import made
from tests.support.gaussian_scenes import camera, cloud, draw, gaussians, turned_about_y

pytestmark = pytest.mark.usefixtures("each_compiled")
KINDS = [torch.float32, torch.float64]
"""Drawn by the compiled back ends and by `reference`."""


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize(
    ("z", "seen"), [(-1.0, False), (0.0, False), (1e-6, False), (0.01, False), (0.0101, True), (0.2, True)]
)
def test_s1_at_and_behind_the_camera(z: float, seen: bool, dtype: torch.dtype) -> None:
    out, gradients = drawn(gaussians([0, 0, z], 0.01, dtype=dtype), camera())
    assert bool(out.alpha.any()) == seen
    assert any(bool(v.any()) for v in gradients.values()) == seen


def test_s1_gradients_beside_the_near_plane() -> None:
    derivative(gaussians([0.001, 0.002, 0.0101], 0.0005), camera(), "mean", step=1e-8)
    agree(gaussians([0.001, 0.002, 0.0101], 0.0005), camera())


@pytest.mark.parametrize("degrees", [0, 20, 40, 60, 70, 80, 85, 89])
def test_s2_far_outside_the_frustum(degrees: float) -> None:
    """Unclamped, the affine approximation stretches like 1/cos^2 and a ball at 89 degrees crosses the whole picture."""
    direction = np.radians(degrees)
    out = agree(gaussians([2 * np.sin(direction), 0, 2 * np.cos(direction)], 0.05), camera())
    assert float(out.alpha.detach().max()) <= 0.8
    if degrees >= 60:
        assert not out.alpha.any()


@pytest.mark.parametrize("dtype", KINDS)
def test_s2_the_limit_prevents_a_smear_and_follows_the_principal_point(dtype: torch.dtype) -> None:
    wide = gaussians([3.0, 0, 0.3], 0.2, dtype=dtype)
    assert not drawn(wide, camera())[0].alpha.any()
    assert drawn(wide, camera(), Cutoffs(frustum_margin=1e3))[0].alpha.any()  # the smear
    g = gaussians([[0.9, 0.1, 1.0], [-0.2, 0, 1.0]], 0.1, dtype=dtype)
    mirrored = dataclasses.replace(g, mean=g.mean * torch.tensor([-1.0, 1, 1], dtype=dtype))
    right, left = draw(g, camera(cx=14.4)), draw(mirrored, camera(cx=48 - 14.4))
    torch.testing.assert_close(right.alpha, left.alpha.flip(1), atol=1e-6 if dtype == torch.float32 else 1e-12, rtol=0)


def test_s2_gradients_on_both_sides_of_the_limit() -> None:
    for x in (0.62, 0.63):  # the limit lies at x/z = 0.48 + 0.144 = 0.624
        g = gaussians([x, 0.1, 1.0], 0.1)
        derivative(g, camera(), "mean")
        agree(g, camera())


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-6, 1e-3])
@pytest.mark.parametrize("low_pass", [0.0, 0.3])
def test_s3_smaller_than_a_pixel(scale: float, low_pass: float) -> None:
    out = agree(gaussians([0.01, 0.005, 2.0], scale), camera(), Cutoffs(low_pass=low_pass))
    if low_pass:  # variances add; the cut at 1/255 takes 0.5 % of the energy, sampling at 0.55 px sigma 1 %
        assert float(out.alpha.detach().sum()) == pytest.approx(2 * np.pi * (0.3 + (25 * scale) ** 2) * 0.8, rel=0.02)


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize("scale", [0.02, 0.04, 0.1])
def test_s4_compensation_keeps_the_energy(scale: float, dtype: torch.dtype) -> None:
    """What the picture of a Gaussian weighs with the low pass, compensated,
    is what it weighs finely sampled without."""
    blurred = Cutoffs(low_pass=0.3, compensation=True, alpha_min=1e-6)
    out, _ = drawn(gaussians([0.01, 0.005, 2.0], scale, 0.9, dtype=dtype), camera(), blurred)
    fine = camera(48 * 8, 40 * 8, 50.0 * 8)
    sharp, _ = drawn(gaussians([0.01, 0.005, 2.0], scale, 0.9, dtype=dtype), fine, Cutoffs(alpha_min=1e-6))
    # the factor is the root of a ratio of determinants: exact for the area, so only sampling and the tail remain
    assert float(out.alpha.detach().sum()) == pytest.approx(float(sharp.alpha.detach().sum()) / 64, rel=0.01)


def test_s4_compensation_has_a_floor_and_no_gradient_below_it() -> None:
    cut = Cutoffs(low_pass=0.3, compensation=True)
    for scale in (0.0, 1e-6, 0.02):  # factor 0, 2e-9 and 0.2
        agree(gaussians([0.01, 0.005, 2.0], scale, 1.0), camera(), cut)
    derivative(gaussians([0.01, 0.005, 2.0], [[0.02, 0.015, 0.01]], 0.9), camera(), "scale", cut)


@pytest.mark.parametrize("ratio", [1.0, 1e2, 1e4, 1e6])
def test_s5_needles(ratio: float) -> None:
    """The determinant is a squared length: never negative, and in float32 as near to float64's as the ratio allows."""
    rotation = turned_about_y(30) @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])
    g = gaussians([0.1, 0.05, 2.0], [[0.5, 0.5 / ratio, 0.5 / ratio]], rotation=rotation)
    areas = []
    for dtype in KINDS:
        p = project(to(g, dtype), camera(), Cutoffs())
        w = p.whitening.double()
        areas.append(float((w[:, 0] * w[:, 3] - w[:, 1] * w[:, 2]).abs().sum()))
        drawn(to(g, dtype), camera())
    # a cross product of nearly parallel float32 rows loses the digits of the ratio;
    # the square of it would lose all at 1e4
    assert areas[0] == pytest.approx(areas[1], rel=max(1e-5, 2e-7 * ratio))
    if ratio <= 1e2:
        agree(g, camera(), picture=1e-4, gradient=1e-4)


@pytest.mark.parametrize("dtype", KINDS)
def test_s6_no_alpha_above_its_opacity(dtype: torch.dtype) -> None:
    """The exponent is a sum of two squares: there is no conic that is not positive."""
    rng = np.random.default_rng(0)
    g = dataclasses.replace(
        cloud(200, dtype=dtype),
        opacity=torch.full((200,), 0.3, dtype=dtype),
        scale=torch.as_tensor(10.0 ** rng.uniform(-5, 1, (200, 3)), dtype=dtype),
    )
    for i in range(0, 200, 10):
        one = Gaussians(*(getattr(g, name)[i : i + 1] for name in FIELDS))
        assert float(draw(one, camera()).alpha.max()) <= 0.3 * (1 + 5e-7)  # log2 and exp2 in float32: 4 ulp


def test_s7_a_stack_of_opaque_gaussians() -> None:
    """Two at the cap of 0.99 are seen, in either precision; the third would leave 1e-6."""
    z = torch.linspace(1, 2, 100, dtype=torch.float64)
    # 1 - 0.99 in float32
    out = agree(gaussians(torch.stack([z * 0, z * 0, z], dim=1), 10.0, 1.0), camera(), gradient=5e-5)
    torch.testing.assert_close(out.alpha, torch.full_like(out.alpha, 0.9999), atol=1e-7, rtol=0)


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize("opacity", [0.985, 0.9895, 0.995, 1.0])
def test_s8_one_cap_forward_and_backward(opacity: float, dtype: torch.dtype) -> None:
    """Above the cap the gradient is zero, below it is not."""
    value = torch.tensor([opacity], dtype=dtype, requires_grad=True)
    g = dataclasses.replace(gaussians([0, 0, 2.0], 0.5, dtype=dtype), opacity=value)
    out = draw(g, camera(1, 1))
    out.alpha.sum().backward()
    assert value.grad is not None
    assert float(out.alpha.detach()) == pytest.approx(min(opacity, 0.99))
    assert float(value.grad) == pytest.approx(1.0 if opacity < 0.99 else 0.0)


@pytest.mark.parametrize("opacity", [0.985, 0.9899, 0.9901, 0.999])
def test_s8_gradients_beside_the_cap(opacity: float) -> None:
    g = gaussians([[0.0, 0, 2.0], [0.1, 0.05, 2.5]], 0.3, torch.tensor([opacity, 0.7]))
    derivative(g, camera(9, 9, 12.0), "opacity")
    agree(g, camera(9, 9, 12.0))


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize(("first", "alpha"), [(0.9375, 0.9375), (0.921875, 0.99389648)])
def test_s9_the_gaussian_that_would_bring_darkness_is_dropped(first: float, alpha: float, dtype: torch.dtype) -> None:
    """At the stop itself a pixel counts as dark, and the next Gaussian is dropped with all behind it. Powers of two:
    exact in both precisions."""
    g = gaussians([[0.0, 0, 1.0], [0, 0, 2.0], [0, 0, 3.0]], 1e4, torch.tensor([first, first, 0.5]), dtype=dtype)
    out, _ = drawn(g, camera(1, 1), Cutoffs(transmittance_stop=1 / 256))
    assert float(out.alpha.detach()) == pytest.approx(alpha, abs=1e-6)


@pytest.mark.parametrize("second", [0.9890, 0.9895, 0.9905])
def test_s9_gradients_beside_the_stop(second: float) -> None:
    """The transmittance behind the second is 1.1e-4, 1.05e-4 and (at the cap of 0.995) below the stop."""
    cut = Cutoffs(alpha_max=0.995)
    g = gaussians([[0.0, 0, 1.0], [0.01, 0, 2.0], [0, 0.02, 3.0]], 5.0, torch.tensor([0.99, second, 0.9]))
    derivative(g, camera(3, 3), "opacity", cut)
    # 1 - 0.99 in float32 is off by 6e-6 of itself, and so is what lies behind
    agree(g, camera(3, 3), cut, gradient=5e-5)


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize(
    ("opacity", "seen"), [(0.0, False), (1e-9, False), (1 / 255 - 1e-6, False), (1 / 255 + 1e-6, True)]
)
def test_s10_smallest_alpha(opacity: float, seen: bool, dtype: torch.dtype) -> None:
    # half a pixel: exactly on a pixel centre
    out, _ = drawn(gaussians([0.02, 0.02, 2.0], 0.5, opacity, dtype=dtype), camera())
    assert bool(out.alpha.any()) == seen


def test_s10_gradients_beside_the_smallest_alpha() -> None:
    for opacity in (0.0045, 0.006):
        g = gaussians([0.013, 0.017, 2.0], 0.06, opacity)
        derivative(g, camera(), "mean")
        agree(g, camera())


@pytest.mark.parametrize("dtype", [torch.float16, *KINDS])
@pytest.mark.parametrize("length", [1e-30, 1e-20, 1.0, 1e20])
def test_s11_quaternions_of_any_length(length: float, dtype: torch.dtype) -> None:
    q = (torch.tensor([[0.5, -0.1, 0.7, 0.3]], dtype=torch.float64) * length).to(dtype)
    finite = bool((q != 0).any() and torch.isfinite(q).all())
    r = rotations(q)
    assert r.dtype == (torch.float32 if dtype == torch.float16 else dtype)
    if finite:
        torch.testing.assert_close(
            r[0].double() @ r[0].double().T, torch.eye(3, dtype=torch.float64), atol=1e-5, rtol=0
        )
    else:
        assert torch.isnan(r).all()


@pytest.mark.parametrize("length", [1e-30, 1e-20, 1e20, 1e30])
def test_s11_splat_files_turn_their_gaussians_whatever_the_length_of_a_quaternion(length: float) -> None:
    """Squares of 1e20 are infinite in float32, and what is divided by infinity is not turned at all."""
    splats = made(1, 0)
    short = dataclasses.replace(splats, quaternion=np.float32([[0.5, -0.1, 0.7, 0.3]]))
    long = dataclasses.replace(splats, quaternion=(np.array([[0.5, -0.1, 0.7, 0.3]]) * length).astype(np.float32))
    torch.testing.assert_close(scene_of(long).rotation, scene_of(short).rotation, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dtype", KINDS)
def test_s11_a_quaternion_of_length_zero_is_masked_and_gets_no_gradient(dtype: torch.dtype) -> None:
    q = torch.tensor([[0.0, 0, 0, 0], [1.0, 0.2, 0, 0]], dtype=dtype, requires_grad=True)
    g = gaussians([[0.0, 0, 2.0], [0.1, 0, 2.0]], [[0.1, 0.05, 0.02]], dtype=dtype)
    out = draw(dataclasses.replace(g, rotation=rotations(q)), camera())
    out.color.sum().backward()
    assert out.masked == 1
    assert q.grad is not None
    assert not q.grad[0].any()
    assert q.grad[1].any()


@pytest.mark.parametrize("dtype", KINDS)
def test_s12_huge_scales(dtype: torch.dtype) -> None:
    out, _ = drawn(gaussians([[0, 0, 2.0], [0.3, 0, 3.0]], 1e3, 0.5, dtype=dtype), camera())
    torch.testing.assert_close(out.alpha, torch.full_like(out.alpha, 0.75), atol=1e-4, rtol=0)
    drawn(gaussians([0, 0, 2.0], 1e30, dtype=dtype), camera())


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", FIELDS)
def test_s13_not_finite_is_masked_and_counted(name: str, bad: float, dtype: torch.dtype) -> None:
    g = cloud(20, dtype=dtype)
    poisoned = dataclasses.replace(g, **{name: getattr(g, name).clone()})
    getattr(poisoned, name)[7, ...] = bad
    rest = [i for i in range(20) if i != 7]
    clean, clean_gradients = drawn(Gaussians(*(getattr(g, n)[rest] for n in FIELDS)), camera())
    out, gradients = drawn(poisoned, camera())
    assert out.masked == (1,)
    assert all(torch.equal(a, b) for a, b in zip(pictures(out), pictures(clean), strict=True))
    for n in FIELDS:
        assert not gradients[n][7].any()
        torch.testing.assert_close(gradients[n][rest], clean_gradients[n], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["intrinsics", "world_to_camera"])
def test_s13_a_camera_that_is_not_finite_is_refused(name: str, bad: float, dtype: torch.dtype) -> None:
    cam = camera()
    broken = np.array(getattr(cam, name))
    broken[0, 2] = bad
    with pytest.raises(ValueError, match=f"{name} holds numbers that are not finite"):
        draw(cloud(3, dtype=dtype), dataclasses.replace(cam, **{name: broken}))


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize("count", [0, 1, 7, 8, 9])
@pytest.mark.parametrize("size", [(1, 1), (3, 50), (33, 17)])
def test_s14_empty_scenes_and_odd_pictures(size: tuple[int, int], count: int, dtype: torch.dtype) -> None:
    cam = camera(*size, focal=20.0)
    out, _ = drawn(cloud(count, dtype=dtype), cam)
    assert out.alpha.shape == (1, size[1], size[0])
    behind = gaussians([[0.0, 0, -1.0]] * count, dtype=dtype)
    assert not drawn(behind, cam)[0].alpha.any()


@pytest.mark.parametrize("dtype", KINDS)
def test_s15_equal_depths_are_blended_in_the_order_of_the_input(dtype: torch.dtype) -> None:
    mean = torch.tensor([[0.0, 0, 2.0]]).repeat(5, 1)
    g = gaussians(mean, 0.5, 0.5, torch.eye(5, 3, dtype=dtype), dtype=dtype)
    out = draw(g, camera())
    assert out.color[20, 24, 0] > 1.9 * out.color[20, 24, 1] > 3.6 * out.color[20, 24, 2] > 0
    assert torch.equal(out.color, draw(g, camera()).color)


def test_s15_order_of_the_input_matters_only_between_equal_depths() -> None:
    g = cloud(500, dtype=torch.float32)
    order = torch.randperm(500, generator=torch.Generator().manual_seed(1))
    shuffled = Gaussians(*(getattr(g, n)[order] for n in FIELDS))
    assert len(g.mean[:, 2].unique()) == 500
    a, b = draw(g, camera()), draw(shuffled, camera())
    assert torch.equal(a.color, b.color)
    assert torch.equal(a.alpha, b.alpha)


@pytest.mark.parametrize("dtype", KINDS)
@pytest.mark.parametrize(
    ("u", "v", "cx", "cy"), [(24.0, 20.0, 24.0, 20.0), (17.3, 12.8, 24.0, 20.0), (30.25, 9.6, 14.4, 31.0)]
)
def test_s16_s17_centroid_lies_where_it_projects(u: float, v: float, cx: float, cy: float, dtype: torch.dtype) -> None:
    """Half a pixel from a corner, not on it; also with the principal point at 0.3 of the width."""
    z, cut = 2.0, Cutoffs(alpha_min=1e-9, alpha_max=1.0, transmittance_stop=0.0)
    out = draw(gaussians([(u - cx) / 50 * z, (v - cy) / 50 * z, z], scale=0.05, dtype=dtype), camera(cx=cx, cy=cy), cut)
    rows, columns = torch.meshgrid(torch.arange(40) + 0.5, torch.arange(48) + 0.5, indexing="ij")
    total = out.alpha.sum()
    assert abs(float((out.alpha * columns).sum() / total) - u) < 1e-4
    assert abs(float((out.alpha * rows).sum() / total) - v) < 1e-4


@pytest.mark.parametrize("dtype", KINDS)
def test_s18_background_is_transmittance_times_its_colour(dtype: torch.dtype) -> None:
    g, cam = cloud(60, dtype=dtype), camera()
    cut = Cutoffs(alpha_max=0.999999, transmittance_stop=-1.0)
    sheet = gaussians([0, 0, 1e3], 1e6, 1.0, (1.0, 1.0, 1.0), dtype=dtype)
    black, white = draw(g, cam, cut), draw(Gaussians.concatenate([g, sheet]), cam, cut)
    torch.testing.assert_close(white.color, black.color + (1 - black.alpha)[..., None], atol=3e-6, rtol=0)
    assert bool((black.color <= black.alpha[..., None] + 1e-6).all())


def test_s19_negative_colours_are_blended_as_they_are_and_written_as_black() -> None:
    g = dataclasses.replace(cloud(30), color=torch.full((30, 3), -5.0, dtype=torch.float64))
    out = agree(g, camera())
    torch.testing.assert_close(out.color, -5 * out.alpha[..., None].expand_as(out.color))
    assert not quantise(out.color).any()


def test_s20_float32_stays_near_float64() -> None:
    """Thresholds flip for single contributions of 1/255,
    so the share of values beyond 1e-5 is bounded beside the maximum."""
    g = cloud(400, dtype=torch.float32)
    single, double = draw(g, camera()), draw(to(g, torch.float64), camera())
    difference = (single.color - double.color).abs()
    assert float(difference.max()) < 1.5 / 255
    assert float((difference > 1e-5).double().mean()) < 1e-3
    assert float(difference.mean()) < 1e-6


def test_s21_bytes_are_clipped_and_never_wrap() -> None:
    values = torch.tensor([1.2, 1.0000001, 1.0, 0.5, -0.1, float("nan"), float("inf"), -float("inf")])
    assert quantise(values).tolist() == [255, 255, 255, 128, 0, 0, 255, 0]


@pytest.mark.parametrize("degrees", [80.0, 89.0, 89.99, 90.0])
@pytest.mark.parametrize("thickness", [0.0, 1e-6, 1e-3])
def test_s22_a_disc_seen_edge_on(degrees: float, thickness: float) -> None:
    g = gaussians([0.05, 0.02, 2.0], [[0.1, 0.1, thickness]], rotation=turned_about_y(degrees))
    for dtype in KINDS:
        out, _ = drawn(to(g, dtype), camera())
        assert float(out.alpha.detach().max()) <= 0.8 * (1 + 5e-7)
    agree(g, camera(), Cutoffs(low_pass=0.3))


def test_a_tile_in_which_nothing_blends_keeps_the_gradients_of_the_others() -> None:
    """A faint Gaussian whose box holds a pixel centre and whose ellipse does not: silhouettes have such tiles,
    random scenes have not."""
    c = np.sqrt(0.5)
    diagonal = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1.0]])
    needle = gaussians([0.205, -0.205, 2.0], [[0.08, 0.0005, 0.0005]], 0.02, rotation=diagonal)
    visible = gaussians([[-0.6, 0.4, 2.0], [0.6, -0.4, 2.0]], 0.05)
    both = agree(Gaussians.concatenate([needle, visible]), camera())
    assert torch.equal(both.alpha, agree(visible, camera()).alpha)
    single = drawn(to(Gaussians.concatenate([needle, visible]), torch.float32), camera())[1]
    alone = drawn(to(visible, torch.float32), camera())[1]
    assert all(torch.equal(single[n][1:], alone[n]) for n in FIELDS)
