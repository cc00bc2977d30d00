"""Correlation along rows: equal to plain loops, matches where they are,
exact coordinates, and what lies beside the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.network.model.correlation import Correlation, columns_of, volume_bytes
from posegaussian.stages.network.model.warping import projection, warp, warped_correlation
from tests.support.known_geometry import camera, on_ring

LEVELS, RADIUS = 3, 2


def features(width: int = 11, other: int = 11, dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(0)
    return torch.randn(2, 5, 3, width, generator=g, dtype=dtype), torch.randn(2, 5, 3, other, generator=g, dtype=dtype)


def looped(first: torch.Tensor, second: torch.Tensor, columns: torch.Tensor, levels: int, radius: int) -> np.ndarray:
    """The definition, in float64: every cell the mean of its columns, zero beside the map, linear between cells."""
    a, b, place = first.double().numpy(), second.double().numpy(), columns.double().numpy()
    batch, channels, height, width = a.shape
    out = np.zeros((batch, levels * (2 * radius + 1), height, width))
    for n, y, x in np.ndindex(batch, height, width):
        line = a[n, :, y, x] @ b[n, :, y] / math.sqrt(channels)
        for level in range(levels):
            size = 2**level
            cells = [line[i : i + size].mean() for i in range(0, len(line), size)]
            centre = (place[n, 0, y, x] + 0.5) / size - 0.5
            for k in range(-radius, radius + 1):
                at = centre + k
                low = math.floor(at)
                pair = [cells[i] if 0 <= i < len(cells) else 0.0 for i in (low, low + 1)]
                out[n, level * (2 * radius + 1) + k + radius, y, x] = pair[0] + (at - low) * (pair[1] - pair[0])
    return out


def places(width: int, other: int) -> torch.Tensor:
    return torch.rand(2, 1, 3, width, generator=torch.Generator().manual_seed(1)) * (other + 8) - 4


@pytest.mark.parametrize(("width", "other"), [(11, 11), (8, 13), (3, 2), (1, 1), (5, 16)])
@pytest.mark.parametrize("budget", [2**20, 0], ids=["volume", "at the look-up"])
def test_equals_a_plain_loop_whatever_the_width(width: int, other: int, budget: int) -> None:
    first, second = features(width, other)
    columns = places(width, other)
    found = Correlation(first, second, LEVELS, RADIUS, budget).look_up(columns)
    # Products of 5 channels in float32, and columns whose fraction is float32: a few units in the last place of 10.
    np.testing.assert_allclose(found.numpy(), looped(first, second, columns, LEVELS, RADIUS), atol=1e-5)


@pytest.mark.parametrize("shift", [-3, 0, 4])
def test_shifted_features_shift_the_peak_by_as_much(shift: int) -> None:
    first = torch.nn.functional.normalize(torch.randn(1, 16, 4, 24, generator=torch.Generator().manual_seed(2)), dim=1)
    second = torch.roll(first, -shift, 3)  # what is at column j here is at column j - shift there
    found = Correlation(first, second, 1, 5).look_up(columns_of(torch.zeros(1, 1, 4, 24)))
    assert (found.argmax(1)[..., 6:18] - 5 == -shift).all()
    assert torch.equal(
        Correlation(first, second, 1, 0).look_up(columns_of(torch.full((1, 1, 4, 24), float(shift))))[..., 6:18],
        found[:, 5 - shift, None, :, 6:18],
    )


def test_at_whole_columns_a_look_up_is_exact_and_between_them_linear() -> None:
    first, second = features()
    correlation = Correlation(first, second, 1, 1)
    assert correlation.volume is not None
    columns = torch.arange(11.0).expand(2, 1, 3, 11)
    middle = correlation.look_up(columns)[:, 1]
    assert torch.equal(middle, correlation.volume[0].diagonal(dim1=2, dim2=3))
    half = correlation.look_up(columns + 0.5)[:, 1, :, :-1]
    assert torch.equal(
        half, 0.5 * correlation.look_up(columns)[:, 1, :, :-1] + 0.5 * correlation.look_up(columns)[:, 2, :, :-1]
    )


@pytest.mark.parametrize("budget", [2**20, 0], ids=["volume", "at the look-up"])
def test_gradients_are_those_of_finite_differences(budget: int) -> None:
    first, second = (f[:1, :2, :1, :5].clone().requires_grad_() for f in features(dtype=torch.float64))
    columns = torch.tensor([0.3, -0.6, 3.7, 4.4, 9.0], dtype=torch.float64).reshape(1, 1, 1, 5).requires_grad_()

    def looked(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
        return Correlation(a, b, 2, 1, budget).look_up(c, coordinate_gradient=True)

    assert torch.autograd.gradcheck(looked, (first, second, columns))


def test_the_gradient_reaches_columns_only_where_it_is_asked_for() -> None:
    first, second = (f.requires_grad_() for f in features())
    for wanted in (False, True):
        columns = places(11, 11).requires_grad_()
        Correlation(first, second, LEVELS, RADIUS).look_up(
            columns, coordinate_gradient=wanted
        ).square().sum().backward()
        assert (columns.grad is not None) == wanted
    assert first.grad is not None
    assert second.grad is not None


def test_beside_the_map_the_value_fades_over_one_cell_and_is_zero() -> None:
    first, second = torch.ones(1, 4, 1, 4), torch.ones(1, 4, 1, 4)
    columns = torch.tensor([-0.25, 3.5, -1e30, torch.inf]).reshape(1, 1, 1, 4)
    assert Correlation(first, second, 1, 0).look_up(columns).flatten().tolist() == [1.5, 1.0, 0.0, 0.0]
    assert Correlation(first, second, 1, 0).look_up(torch.full((1, 1, 1, 4), torch.nan)).isnan().all()


def test_columns_added_to_the_other_picture_change_nothing_inside() -> None:
    """The width of a picture is no part of a disparity: a match is as far, in columns, in a wider one."""
    first, second = features(8, 12)
    columns = places(8, 12).clamp(3, 4)
    wide = torch.nn.functional.pad(second, (0, 4), value=3.0)
    narrow_found, wide_found = (Correlation(first, s, 2, 1).look_up(columns) for s in (second, wide))
    assert torch.equal(narrow_found, wide_found)


def test_half_precision_comes_in_and_float32_is_computed_even_under_autocast() -> None:
    first, second = (20 * f for f in features())
    plain = Correlation(first.bfloat16().float(), second.bfloat16().float(), LEVELS, RADIUS).look_up(places(11, 11))
    with torch.autocast("cpu", torch.bfloat16):
        found = Correlation(first.bfloat16(), second.bfloat16(), LEVELS, RADIUS).look_up(places(11, 11))
    assert found.dtype == torch.float32
    assert torch.equal(found, plain)


@pytest.mark.parametrize("budget", [2**24, 0], ids=["volume", "at the look-up"])
def test_one_and_two_threads_give_the_same_bytes(budget: int) -> None:
    g = torch.Generator().manual_seed(3)
    first, second = torch.randn(1, 48, 24, 40, generator=g), torch.randn(1, 48, 24, 37, generator=g)
    columns, results, before = torch.rand(1, 1, 24, 40, generator=g) * 40, [], torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            leaves = [f.clone().requires_grad_() for f in (first, second)]
            found = Correlation(*leaves, 4, 4, budget).look_up(columns)
            found.square().sum().backward()
            results.append([found.detach(), *(leaf.grad for leaf in leaves)])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_bytes_are_those_of_the_volume_and_the_budget_decides() -> None:
    first, second = features(11, 7)
    volume = Correlation(first, second, LEVELS, RADIUS).volume
    assert volume is not None
    needed = volume_bytes(2, 3, 11, 7, LEVELS)
    assert needed == sum(v.numel() * v.element_size() for v in volume)
    assert Correlation(first, second, LEVELS, RADIUS, needed - 1).volume is None


def test_what_does_not_fit_is_refused() -> None:
    first, second = features()
    for bad in ((first, second[:, :3]), (first, second[:, :, :2]), (first, second[..., :0])):
        with pytest.raises(ValueError, match="do not correlate"):
            Correlation(*bad, 1, 1)
    with pytest.raises(ValueError, match="0 levels"):
        Correlation(first, second, 0, 1)
    with pytest.raises(ValueError, match="columns of shape"):
        Correlation(first, second, 1, 1).look_up(torch.zeros(2, 1, 3, 10))


SIZE, FOCAL, STRIDE = (48, 40), 45.0, 4
VIEWS = [camera(on_ring(a), np.zeros(3)) for a in (0, 25)]


def third_view() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intrinsics of both, and two poses."""
    intrinsics = np.array([[FOCAL, 0, SIZE[0] / 2 + 1.5], [0, FOCAL, SIZE[1] / 2 - 2], [0, 0, 1]])
    return intrinsics, VIEWS[0], VIEWS[1]


def ramp() -> torch.Tensor:
    """Features that are their own place: (u, v) of each cell."""
    h, w = SIZE[1] // STRIDE, SIZE[0] // STRIDE
    v, u = torch.meshgrid(torch.arange(h) + 0.5, torch.arange(w) + 0.5, indexing="ij")
    return torch.stack([u, v])[None]


def test_warping_reads_where_the_rig_projects() -> None:
    k, first, second = third_view()
    depth = torch.linspace(1.6, 2.4, 12 * 10).reshape(1, 1, 10, 12)
    found, seen = warp(ramp(), depth, projection(k, first, k, second, STRIDE)[None])
    cells = np.diag([1 / STRIDE, 1 / STRIDE, 1]) @ k
    expected = project(unproject(depth[0, 0].double().numpy(), cells, first), cells, second)[0]
    inner = seen[0, 0].numpy() & (expected > 0.5).all(-1) & (expected < np.array([11.5, 9.5])).all(-1)
    assert inner.sum() > 50
    # Places of tens of cells in float32.
    np.testing.assert_allclose(found[0, 0].permute(1, 2, 0).numpy()[inner], expected[inner], atol=2e-5)
    assert not seen[0, 0].numpy()[((expected < 0) | (expected > np.array([12, 10]))).any(-1)].any()


@pytest.mark.parametrize("bad", [0.0, -2.0, math.nan, math.inf, 1e-30])
def test_what_has_no_place_in_the_other_view_is_zero_and_passes_no_gradient(bad: float) -> None:
    k, first, second = third_view()
    depth = torch.full((1, 2, 10, 12), 2.0)
    depth[:, 1] = bad
    depth.requires_grad_()
    features = ramp().requires_grad_()
    found, seen = warp(features, depth, projection(k, first, k, second, STRIDE)[None])
    found.sum().backward()
    assert torch.isfinite(found).all()
    assert seen[:, 0].any()
    if bad != 1e-30:
        assert not seen[:, 1].any()
    assert depth.grad is not None
    assert features.grad is not None
    assert torch.isfinite(depth.grad).all()
    assert not depth.grad[~seen].any()
    assert torch.isfinite(features.grad).all()


def test_a_point_behind_the_other_camera_is_not_seen() -> None:
    k, first, _ = third_view()
    turned = np.diag([-1.0, 1.0, -1.0, 1.0]) @ first
    assert not warp(ramp(), torch.full((1, 1, 10, 12), 2.0), projection(k, first, k, turned, STRIDE)[None])[1].any()


def test_the_right_depth_correlates_best_and_unseen_views_do_not_count() -> None:
    """Random features on a plane, a cell and more from where the other depths would have them."""
    k, first, second = third_view()
    g = torch.Generator().manual_seed(4)
    other = torch.randn(1, 64, 10, 12, generator=g)
    there = projection(k, first, k, second, STRIDE)[None]
    depths = torch.tensor([1.2, 1.5, 2.0, 2.8, 4.2]).reshape(1, 5, 1, 1).expand(1, 5, 10, 12)
    mine = warp(other, depths[:, 2:3], there)[0][:, 0]
    value, share = warped_correlation(mine, [(other, there)], depths)
    seen = share[:, 2] == 1
    assert seen.sum() > 40
    assert (value.argmax(1)[seen] == 2).float().mean() > 0.9
    away = projection(k, first, k, np.diag([-1.0, 1.0, -1.0, 1.0]) @ first, STRIDE)[None]
    both = warped_correlation(mine, [(other, there), (other, away)], depths)
    assert torch.equal(both[0], value)
    assert torch.equal(both[1], share / 2)
    assert not warped_correlation(mine, [], depths)[0].any()
