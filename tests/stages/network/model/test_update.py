"""The recurrent refinement: depth coding and its bounds, convex up-sampling,
and steps that do not depend on what follows."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.network.model.correlation import Correlation
from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.refine import DepthRefinement, Refined
from posegaussian.stages.network.model.update import ConvGRU, convex_weights, upsample
from posegaussian.stages.network.model.warping import projection
from tests.support.known_geometry import camera, on_ring, rig_of

FACTOR, CELLS = 4, (6, 9)
NEAR, FAR = 1.0, 4.0
PAIR = rectify(rig_of([camera(on_ring(a), np.zeros(3)) for a in (0, 30)], (96, 80), 90.0), 0, 1, np.zeros(3))


def coding(batch: int = 1, scale: float = 60.0, offset: float = -30.0, near: float = NEAR, far: float = FAR) -> Coding:
    """Disparity 0 at 2 m, from -15 px at 4 m to 30 px at 1 m."""
    return Coding(*(torch.full((batch,), v, dtype=torch.float64) for v in (scale, offset, near, far)))


def network(further_views: bool = False, wild: float = 0.0) -> DepthRefinement:
    """A small network; with `wild` its last layers are random, and its steps are as large."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        net = DepthRefinement(8, 12, 2, 2, FACTOR, further_views)
        if wild:
            for layer in (net.update.delta[-1], net.update.mask[-1], net.confidence):
                torch.nn.init.normal_(layer.weight, std=wild)
    return net


def inputs(batch: int = 1, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    first, second = torch.randn(2, batch, 8, *CELLS, generator=g)
    return first, second, torch.randn(batch, 1, FACTOR * CELLS[0], FACTOR * CELLS[1], generator=g)


def plane(height: int, width: int) -> torch.Tensor:
    y, x = torch.meshgrid(
        torch.arange(height, dtype=torch.float64), torch.arange(width, dtype=torch.float64), indexing="ij"
    )
    return (0.25 * x - 0.1 * y + 2)[None, None]


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("start", [(0, 0), (17, 5)])
def test_disparity_is_the_distance_of_the_columns_of_both_windows(which: int, start: tuple[int, int]) -> None:
    """Projecting a point into both rectified cameras, in either direction and in cropped windows, gives the coded
    disparity and its depth back."""
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3))
    windows = [(start[0], 3, 60, 60), (start[1], 3, 60, 60)]
    (a, depth), (b, _) = (project(points, PAIR.intrinsics[i], PAIR.world_to_camera(i)) for i in (which, 1 - which))
    columns = (a[:, 0] - windows[which][0]) - (b[:, 0] - windows[1 - which][0])
    code = Coding.of([(PAIR, which, windows[which], windows[1 - which])], 0.5, 10)
    shape = (1, 1, 4, 5)
    np.testing.assert_allclose(code.disparity(torch.tensor(depth).reshape(shape)).flatten(), columns, atol=1e-10)
    np.testing.assert_allclose(code.depth(torch.tensor(columns).reshape(shape)).flatten(), depth, rtol=1e-12)


@pytest.mark.parametrize("scale", [60.0, -60.0])
def test_no_disparity_gives_a_depth_that_is_negative_infinite_or_beyond_the_bounds(scale: float) -> None:
    code = coding(scale=scale)
    low, high = code.bounds()
    values = torch.tensor(
        [-torch.inf, -1e30, -30.0, -29.9999, 0.0, 1e-8, 30.0, 1e30, torch.inf], dtype=torch.float32
    ).reshape(1, 1, 3, 3)
    for disparity in (values, values.half(), code.limit(values)):
        depth = code.depth(disparity)
        assert depth.dtype == torch.float32
        assert ((depth >= NEAR) & (depth <= FAR)).all()
    held = code.limit(values)
    assert ((held >= low) & (held <= high)).all()
    assert code.depth(torch.full((1, 1, 1, 1), torch.nan)).isnan().all()


def test_a_wider_picture_of_the_same_cameras_has_wider_disparities_and_the_same_depth() -> None:
    depth = torch.linspace(NEAR, FAR, 12, dtype=torch.float64).reshape(1, 1, 3, 4)
    for times in (0.5, 2.0, 3.7):
        wide = coding(scale=60 * times, offset=-30 * times)
        torch.testing.assert_close(wide.disparity(depth), times * coding().disparity(depth), rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(wide.depth(times * coding().disparity(depth)), depth, rtol=1e-12, atol=0)


def test_beyond_a_bound_the_gradient_passes_only_where_it_leads_back() -> None:
    value = torch.tensor([-99.0, -99.0, 0.0, 0.0, 99.0, 99.0]).reshape(1, 1, 2, 3).requires_grad_()
    pull = torch.tensor([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0]).reshape(1, 1, 2, 3)
    (coding().limit(value) * pull).sum().backward()
    assert value.grad is not None
    assert value.grad.flatten().tolist() == [-1.0, 0.0, -1.0, 1.0, 0.0, 1.0]


def test_the_start_is_the_mean_of_what_is_known() -> None:
    disparity = torch.full((3, 1, 4, 6), torch.nan)
    disparity[0, 0, :2, :2] = torch.tensor([[1.0, 3.0], [torch.nan, 2.0]])
    disparity[0, 0, 2, 2] = 8.0
    disparity[1, 0] = torch.inf  # no number either
    disparity[2, 0] = 1e9
    begin = coding(3).seeded(disparity, 2)
    assert begin[0, 0].tolist() == pytest.approx(np.array([[1.0, 1.75, 1.75], [1.75, 4.0, 1.75]]))
    assert (begin[1] == (30 - 15) / 2 / 2).all()
    assert (begin[2] == 15).all()
    assert coding(1).seeded(disparity[:1, :, :3, :5], 2).shape == (1, 1, 2, 3)


def test_depth_without_surface_has_no_disparity_and_bad_codings_are_refused() -> None:
    depth = torch.tensor([[0.0, -1.0], [torch.nan, torch.inf]])[None, None]
    assert coding().disparity(depth).isnan().all()
    for bad, words in (
        ({"scale": 0.0}, "baseline"),
        ({"near": 4.0}, "near < far"),
        ({"near": 0.0}, "near < far"),
        ({"offset": np.nan}, "finite"),
    ):
        with pytest.raises(ValueError, match=words):
            coding(**bad)


@pytest.mark.parametrize("factor", [1, 2, 3, 8])
def test_up_sampling_keeps_a_plane_before_anything_is_learned(factor: int) -> None:
    cells = F.avg_pool2d(plane(6 * factor, 7 * factor), factor)
    fine = upsample(cells, convex_weights(torch.zeros(1, 9 * factor**2, 6, 7, dtype=torch.float64), factor))
    inner = (..., slice(factor, -factor), slice(factor, -factor))
    torch.testing.assert_close(fine[inner], plane(6 * factor, 7 * factor)[inner], rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [0.5, 1e4])
def test_up_sampling_stays_within_the_neighbours_whatever_the_logits(size: float) -> None:
    g = torch.Generator().manual_seed(0)
    cells, logits = torch.randn(2, 1, 5, 6, generator=g), size * torch.randn(2, 9 * FACTOR**2, 5, 6, generator=g)
    weights = convex_weights(logits, FACTOR)
    fine = upsample(cells, weights)
    padded = F.pad(cells, (1, 1, 1, 1), mode="replicate")
    high, low = (s * F.interpolate(F.max_pool2d(s * padded, 3, 1), scale_factor=FACTOR) for s in (1, -1))
    assert ((fine <= high + 1e-6) & (fine >= low - 1e-6)).all()  # sums of nine in float32
    constant = upsample(torch.full((2, 1, 5, 6), 7.0), weights)
    torch.testing.assert_close(constant, torch.full_like(constant, 7.0))  # at the rim, too
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(upsample(cells, convex_weights(logits, FACTOR)), fine)


def test_up_sampling_places_each_weight_at_its_pixel() -> None:
    """Against a loop over cells, pixels and neighbours."""
    g = torch.Generator().manual_seed(2)
    cells, weights = torch.randn(1, 1, 3, 2, generator=g), convex_weights(torch.randn(1, 9 * 4, 3, 2, generator=g), 2)
    padded, fine = F.pad(cells, (1, 1, 1, 1), mode="replicate")[0, 0], upsample(cells, weights)
    for y, x, i, j in np.ndindex(3, 2, 2, 2):
        expected = sum(
            weights[0, y, x, 3 * a + b, 2 * i + j] * padded[y + a, x + b] for a in range(3) for b in range(3)
        )
        assert float(fine[0, 0, 2 * y + i, 2 * x + j]) == pytest.approx(float(expected), abs=1e-6)


def test_the_recurrence_stays_between_its_state_and_one() -> None:
    gru = ConvGRU(4, 3)
    state, value = torch.rand(1, 4, 5, 5) * 2 - 1, 1e3 * torch.randn(1, 3, 5, 5)
    for _ in range(5):
        state = gru(state, value, torch.zeros(1, 12, 5, 5))
        assert (state.abs() <= 1).all()


def test_before_training_the_start_stands_and_the_confidence_is_its_bias() -> None:
    first, second, _ = inputs()
    start = plane(FACTOR * CELLS[0], FACTOR * CELLS[1]).float()
    found = network()(first, second, start, coding(), 3)
    inner = (..., slice(FACTOR, -FACTOR), slice(FACTOR, -FACTOR))
    for disparity in found.disparities:
        torch.testing.assert_close(disparity[inner], start[inner], rtol=0, atol=1e-5)
    torch.testing.assert_close(found.confidence, torch.full_like(start, 1 / (1 + np.exp(-1))))


def test_the_first_steps_do_not_depend_on_how_many_follow() -> None:
    net, (first, second, start) = network(wild=0.5), inputs(2)
    with torch.no_grad():
        every = net(first, second, start, coding(2), 5)
        for steps in (1, 2, 5):
            fewer = net(first, second, start, coding(2), steps)
            assert len(fewer.disparities) == steps
            assert all(torch.equal(a, b) for a, b in zip(fewer.disparities, every.disparities, strict=False))
            last = net(first, second, start, coding(2), steps, only_last=True)
            assert len(last.disparities) == 1
            assert torch.equal(last.disparities[0], fewer.disparities[-1])
            assert torch.equal(last.confidence, fewer.confidence)
    assert not torch.equal(every.disparities[0], every.disparities[1])


@pytest.mark.parametrize("scale", [60.0, -60.0])
def test_a_network_that_has_gone_wild_stays_within_the_depth_bounds(scale: float) -> None:
    first, second, start = inputs(2)
    code = coding(2, scale=scale)
    start[0], start[1, ..., :9] = torch.nan, 1e6
    found = network(wild=300.0)(first, second, start, code, 6)
    for disparity in found.disparities:
        depth = code.depth(disparity)
        assert ((depth >= NEAR) & (depth <= FAR)).all()
    assert ((found.confidence >= 0) & (found.confidence <= 1)).all()
    assert found.disparities[-1].min() < found.disparities[-1].max()


def test_windows_that_start_elsewhere_give_the_same_depth() -> None:
    """Two cells cut from the other picture, as many as one of the coarsest level holds, move every disparity by two
    cells and nothing else."""
    net, (first, second, start) = network(wild=0.5), inputs()
    second = F.pad(second, (8, 8))
    at, cut = coding(offset=-30.0 - 8 * FACTOR), coding(offset=-30.0 - 6 * FACTOR)
    with torch.no_grad():
        whole = net(first, second, start - 8 * FACTOR, at, 3)
        part = net(first, second[..., 2:], start - 6 * FACTOR, cut, 3)
    # The same numbers about other origins: float32 of disparities up to 50 px.
    torch.testing.assert_close(part.disparities[-1] - 2 * FACTOR, whole.disparities[-1], rtol=0, atol=2e-3)
    torch.testing.assert_close(cut.depth(part.disparities[-1]), at.depth(whole.disparities[-1]), rtol=1e-4, atol=0)


def test_gradients_reach_features_and_every_weight() -> None:
    net, (first, second, start) = network(wild=0.1), inputs()
    first.requires_grad_()
    second.requires_grad_()
    found = net(first, second, start, coding(), 2)
    (sum((d - 1).abs().mean() for d in found.disparities) + found.confidence.mean()).backward()
    for name, value in (("first", first), ("second", second), *net.named_parameters()):
        assert value.grad is not None, name
        assert torch.isfinite(value.grad).all(), name
        assert value.grad.any(), name


def test_pictures_that_are_no_whole_number_of_cells() -> None:
    first, second, start = inputs()
    found = network()(first, second, start[..., :-1, :-3], coding(), 1)
    assert found.disparities[0].shape == found.confidence.shape == (1, 1, FACTOR * CELLS[0] - 1, FACTOR * CELLS[1] - 3)


def run(net: DepthRefinement) -> Refined:
    """Three steps of two directions that a third view sees."""
    first, second, start = inputs(2)
    k = np.array([[90, 0, 18.0], [0, 90, 12], [0, 0, 1]])
    other = torch.randn(2, 8, 5, 7, generator=torch.Generator().manual_seed(2))
    there = projection(k, camera(on_ring(0), np.zeros(3)), k, camera(on_ring(12), np.zeros(3)), FACTOR)
    return net(first, second, start, coding(2), 3, [(other, there.expand(2, 3, 4))])


def test_further_views_have_a_say_and_only_in_a_network_built_for_them() -> None:
    net, (first, second, start) = network(True, wild=0.5), inputs(2)
    with torch.no_grad():
        assert not torch.equal(run(net).disparities[-1], net(first, second, start, coding(2), 3).disparities[-1])
    with pytest.raises(ValueError, match="further_views=True"):
        run(network())


def test_the_pairs_own_other_view_says_the_same_by_warping_as_along_the_rows() -> None:
    """The hypotheses of a further view are the disparities of the look-up, in its order: seen through the rig or
    along the row, one value."""
    whole = (0, 0, *PAIR.size)
    net, code = network(True), Coding.of([(PAIR, 0, whole, whole)], 0.5, 10)
    width, height = (s // FACTOR for s in PAIR.size)
    first, second = torch.randn(2, 1, 8, height, width, generator=torch.Generator().manual_seed(5))
    there = projection(
        PAIR.intrinsics[0], PAIR.world_to_camera(0), PAIR.intrinsics[1], PAIR.world_to_camera(1), FACTOR
    )[None]
    disparity = torch.full((1, 1, height, width), 1.3)
    seen = net._seen(Correlation(first, second, 2, 2), first, disparity, code, [(second, there)])
    rows, warped, share = seen[:, :5], seen[:, 10:15], seen[:, 15:]
    inner = (..., slice(6, -6))
    assert (share[inner] == 1).all()
    # Depth and back through two matrices in float32:
    # places of tens of cells, to 1e-5, of features that differ by a few.
    torch.testing.assert_close(warped[inner], rows[inner], rtol=0, atol=1e-3)


def test_disparities_are_float32_under_autocast_and_near_those_without() -> None:
    net = network(True, wild=0.05)
    with torch.no_grad():
        plain = run(net)
        with torch.autocast("cpu", torch.bfloat16):
            mixed = run(net)
    assert mixed.disparities[-1].dtype == mixed.confidence.dtype == torch.float32
    moved = float((plain.disparities[-1] - plain.disparities[0]).abs().max())
    assert moved > 0.05
    # bf16 has 8 bits: the steps differ by a few per cent of what they are.
    assert float((mixed.disparities[-1] - plain.disparities[-1]).abs().mean()) < 0.1 * moved


def test_one_and_two_threads_give_the_same_bytes() -> None:
    """Of results; gradients are sums over the picture that threads share,
    and training resumes bit-exactly on one thread."""
    net, results, before = network(True, wild=0.5), [], torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.no_grad():
                found = run(net)
            results.append([*found.disparities, found.confidence, found.state])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_what_does_not_fit_is_refused() -> None:
    net, (first, second, start) = network(), inputs()
    with pytest.raises(ValueError, match="0 steps"):
        net(first, second, start, coding(), 0)
    with pytest.raises(ValueError, match="px a cell"):
        net(first, second, start[..., :-4], coding(), 1)
