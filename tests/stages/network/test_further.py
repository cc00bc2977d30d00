"""The third view: which one it is, where the pair's pixels lie in it, and that it fits best at the true depth,
through the whole path."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from posegaussian.stages.geometry.pairs import pair_report
from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from posegaussian.stages.network.inference import Learned, Looks, look
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.pairs import PairViews, SourceView, Third, windows
from posegaussian.stages.network.model.presets import FURTHER_COSTS, PRESETS, Preset
from posegaussian.stages.network.model.warping import warp, warped_correlation
from posegaussian.stages.network.third_view import LEAST, candidates, window_around
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, ring
from tests.support.network_views import UPRIGHT, depth_of_plane, network, plane_depth, random_views, source, two_cameras

torch.set_num_threads(1)
CELL = 8
"""Px of `fast`."""


class Places(torch.nn.Module):
    """Stands for the image encoder: means of cells of the picture, in as many channels."""

    lag = 0.0

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        return [F.pad(F.avg_pool2d(x, CELL), (0, 0, 0, 0, 0, 61))]


class First(torch.nn.Module):
    """Stands for the fusion: the picture's features alone."""

    def forward(self, picture: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        return picture


class Looked(Exception):
    """The look-up was reached."""


def looked_up(
    net: PoseGaussianNetwork, looks: Looks, views: Mapping[int, SourceView], monkeypatch: pytest.MonkeyPatch
) -> tuple[torch.Tensor, list[tuple[torch.Tensor, torch.Tensor]], torch.Tensor]:
    """What `warped_correlation` is asked first of the first pair."""
    asked = []

    def keep(*given: object) -> None:
        asked.extend(given)
        raise Looked

    with monkeypatch.context() as m:
        m.setattr("posegaussian.stages.network.model.refine.warped_correlation", keep)
        with pytest.raises(Looked):
            look(net, looks, views, 1, "float32")
    return asked[0], asked[1], asked[2]


def cells_of(
    rig: Rig, pair: RectifiedPair, which: int, views: Mapping[int, SourceView]
) -> tuple[np.ndarray, np.ndarray]:
    """Points [h, w, 3] of the endless plane at the centres of the cells that the network has of a view, and their
    rectified depth [h, w]."""
    found = windows(pair, (views[pair.views[0]].depth > 0, views[pair.views[1]].depth > 0), CELL)
    assert found is not None
    k = pair.intrinsics[which].copy()
    k[:2, 2] -= found[which][:2]
    k[:2] /= CELL
    depth = depth_of_plane(
        k, pair.world_to_camera(which), (found[which][2] // CELL, found[which][3] // CELL), UPRIGHT, np.inf
    )
    return unproject(depth, k, pair.world_to_camera(which)), depth


@pytest.mark.parametrize(
    ("size", "roll", "zoom"),
    [
        ((128, 128), 0.0, 1.0),
        ((160, 128), 20.0, 1.0),
        ((128, 128), -8.0, 0.7),
        ((160, 128), 0.0, 1.3),
        ((1280, 960), 5.0, 1.0),
    ],
    ids=["alike", "rolled", "wider", "longer", "large"],
)
def test_a_cell_is_looked_up_where_the_rig_has_it_in_the_third_view(
    size: tuple[int, int], roll: float, zoom: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third picture says of each pixel where it is: to a fiftieth of a px, OpenCV's grid between pixels. A half
    would be 25 times that."""
    focal = 1.8 * min(size)
    rig = rig_of(
        [
            camera(on_ring(-12), np.zeros(3)),
            camera(on_ring(12), np.zeros(3)),
            camera(on_ring(37, 14), np.zeros(3), roll),
        ],
        size,
        [focal, focal, zoom * focal],
    )
    views = {v: source(rig, v, plane_depth(rig, v)) for v in range(3)}
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    views[2] = replace(
        views[2],
        color=255 * np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float32),
        mask=np.full(size[::-1], 255, np.uint8),
    )
    looks = Looks.of(rig, (0, 1, 2), 1)
    assert (looks.pairs[0].views, looks.thirds[0]) == ((0, 1), (2,))
    net = network(further_views=True)
    net.image, net.fusion = Places(), First()
    _, ((features, to),), _ = looked_up(net, looks, views, monkeypatch)
    for which in (0, 1):
        points, depth = cells_of(rig, looks.pairs[0], which, views)
        expected, _ = project(points, rig.intrinsics[2], rig.world_to_camera[2])
        found, _ = warp(features[which : which + 1], torch.from_numpy(depth)[None, None], to[which : which + 1])
        u, v, whole = found[0, 0, :3].numpy()
        inside = whole > 1 - 1e-6
        # within half a cell of the window's rim the rim's value stands
        for place, cells in (
            (u, features[which, 0]),
            (v, features[which, 1]),
        ):
            held = cells[features[which, 2] > 1 - 1e-6]
            inside &= (place > float(held.min()) + 0.01) & (place < float(held.max()) - 0.01)
        assert inside.sum() > 60
        # places of a thousand px in float32;
        # a picture looked at in half its size has OpenCV's grid of a 32nd of its own px
        np.testing.assert_allclose(
            np.stack([u, v], axis=-1)[inside], expected[inside], atol=0.02 * max(1, max(size) / 640)
        )


@pytest.mark.parametrize("roll", [0.0, 15.0])
def test_correlation_with_the_third_view_is_best_at_the_true_depth(
    roll: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Untrained features of a coloured plane and the start at its depth: on average the hypothesis in the middle is
    best, to a fifth of a cell."""
    rig = rig_of(
        [camera(on_ring(-12), np.zeros(3)), camera(on_ring(12), np.zeros(3)), camera(on_ring(34), np.zeros(3), roll)],
        (256, 256),
        1.8 * 256,
    )
    views = {v: source(rig, v, plane_depth(rig, v)) for v in range(3)}
    looks = Looks.of(rig, (0, 1, 2), 1)
    net = network(further_views=True)
    first, further, hypotheses = looked_up(net, looks, views, monkeypatch)
    (features, to), middle = further[0], hypotheses.shape[1] // 2
    for which in (0, 1):
        points, depth = cells_of(rig, looks.pairs[0], which, views)
        inside = np.linalg.norm(points, axis=-1) < 0.3  # of 0.45 m: two cells beside it are on the plane, too
        assert inside.sum() > 100
        np.testing.assert_allclose(hypotheses[which, middle].numpy()[inside], depth[inside], rtol=2e-3)
        # less their means, or the brightest features would correlate best with everything
        mine, theirs = (
            f[which : which + 1] - f[which : which + 1].mean((2, 3), keepdim=True) for f in (first, features)
        )
        value, share = warped_correlation(mine, [(theirs, to[which : which + 1])], hypotheses[which : which + 1])
        assert (share[0, middle].numpy()[inside] == 1).all()
        mean = value[0].numpy()[:, inside].mean(axis=1)
        assert mean.argmax() == middle
        left, top, right = mean[middle - 1 : middle + 2]
        assert abs(0.5 * (left - right) / (left - 2 * top + right)) < 0.2


def test_a_mirrored_order_of_the_cameras_takes_the_same_third() -> None:
    rig = ring(8, (256, 256), 300.0)
    pair = rectify(rig, 0, 1, np.zeros(3))
    found = candidates(rig, pair, pair_report(rig, None, 66.0))
    assert set(found) == {7, 2}  # the others are 90 degrees away and more
    order = [5, 2, 0, 7, 1, 3, 4, 6]
    turned = rig.subset(order)
    for a, b in ((0, 1), (1, 0)):
        other_way = rectify(turned, order.index(a), order.index(b), np.zeros(3))
        again = candidates(turned, other_way, pair_report(turned, None, 66.0))
        assert tuple(order[v] for v in again) == found


def test_nearer_ones_come_first_and_those_that_match_neither_view_never() -> None:
    rig = two_cameras(angles=(0.0, 20.0, 70.0, 35.0, 170.0, -30.0))
    assert candidates(rig, rectify(rig, 0, 1, np.zeros(3)), pair_report(rig)) == (3, 5, 2)
    assert candidates(rig, rectify(rig, 0, 1, np.zeros(3)), pair_report(rig, (0, 1, 4))) == ()
    assert Looks.of(rig, (0, 1), 2).thirds == ((),)


def test_a_window_holds_the_subject_and_never_too_few_cells() -> None:
    inside = np.zeros((60, 90), bool)
    assert window_around(inside, 1.0, 8) is None
    inside[20:50, 31:33] = True
    assert window_around(inside, 1.0, 8) == (23, 12, 8 * LEAST, 48)
    x0, y0, width, height = window_around(inside, 2.0, 16) or (0, 0, 0, 0)
    assert (x0, y0) == (2 * 31.5 - 8, 2 * 20.5 - 8)
    assert width % 16 == height % 16 == 0
    assert y0 + height >= 2 * 49.5 + 8


@pytest.fixture(scope="module")
def net() -> PoseGaussianNetwork:
    return network(further_views=True)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return two_cameras((64, 64), angles=(-25.0, 0.0, 28.0))


@pytest.fixture(scope="module")
def shown(rig: Rig) -> dict[int, SourceView]:
    return {v: source(rig, v, plane_depth(rig, v)) for v in range(3)}


@pytest.fixture(scope="module")
def said(net: PoseGaussianNetwork, rig: Rig, shown: dict[int, SourceView]) -> dict[int, Learned]:
    return look(net, Looks.of(rig, (0, 1, 2), 1), shown, 2, "float32")


def test_the_order_of_the_cameras_changes_nothing_but_rounding(
    net: PoseGaussianNetwork, rig: Rig, shown: dict[int, SourceView], said: dict[int, Learned]
) -> None:
    order = [2, 0, 1]
    found = look(
        net, Looks.of(rig.subset(order), (0, 1, 2), 1), {i: shown[v] for i, v in enumerate(order)}, 2, "float32"
    )
    for i, v in enumerate(order):
        scale = float(np.abs(said[v].numbers).max())
        # a start may be of another nearest pixel where a place falls between two; elsewhere sums in another order
        assert np.mean(np.abs(found[i].numbers - said[v].numbers) > 1e-3 * scale) < 1e-3
        np.testing.assert_allclose(found[i].inverse_depth.mean(), said[v].inverse_depth.mean(), rtol=1e-3)


def test_the_third_view_has_a_say_and_one_without_a_surface_is_none(
    net: PoseGaussianNetwork,
    rig: Rig,
    shown: dict[int, SourceView],
    said: dict[int, Learned],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = Looks.of(rig, (0, 1, 2), 1)
    monkeypatch.setattr("posegaussian.stages.network.inference.third_of", lambda *a: None)
    without = look(net, looks, shown, 2, "float32")
    assert any((without[v].numbers != said[v].numbers).any() for v in range(3))
    gone = {**shown, 2: source(rig, 2, np.zeros((64, 64), np.float32))}
    plain = look(net, looks, gone, 2, "float32")
    monkeypatch.undo()
    found = look(net, looks, gone, 2, "float32")
    assert set(found) == {0, 1}
    assert all(found[v].numbers.tobytes() == plain[v].numbers.tobytes() for v in (0, 1))


def test_two_cameras_alone_work(net: PoseGaussianNetwork, rig: Rig, shown: dict[int, SourceView]) -> None:
    found = look(net, Looks.of(rig, (0, 1), 1), {v: shown[v] for v in (0, 1)}, 2, "bf16")
    assert set(found) == {0, 1}
    assert all(
        np.isfinite(f.numbers).all() and np.isfinite(f.inverse_depth).all() and f.confidence.any()
        for f in found.values()
    )


def with_third(views: PairViews, seed: int = 3, size: tuple[int, int] = (CELL * LEAST, 40)) -> PairViews:
    """Third views of noise that see the middle of the pictures."""
    g, pairs = torch.Generator().manual_seed(seed), len(views.start) // 2
    to = (
        torch.tensor([[0.5, 0, 1, 0.3], [0, 0.5, 2, 0], [0, 0, 1, 0]], dtype=torch.float64)
        .expand(2 * pairs, 3, 4)
        .contiguous()
    )
    return replace(
        views,
        third=Third(
            torch.rand(pairs, 3, *size, generator=g), torch.rand(pairs, 17, size[0] // 4, size[1] // 4, generator=g), to
        ),
    )


def test_pairs_with_and_without_a_third_view_stand_in_one_batch(net: PoseGaussianNetwork) -> None:
    one, two = with_third(random_views(1)), random_views(1, seed=1)
    for parts in ([one, two], [two, one]):
        both = PairViews.batch(parts).to(torch.device("cpu"))
        assert both.third is not None
        assert len(both.third.color) == 2
        assert len(both.third.projection) == 4
        found = net(both, 2)
        for i, part in enumerate(parts):
            alone = net(part, 2)
            torch.testing.assert_close(
                found.numbers["scale"][2 * i : 2 * i + 2], alone.numbers["scale"], rtol=1e-4, atol=1e-5
            )
    assert PairViews.batch([two, two]).third is None
    assert not torch.equal(net(one, 2).numbers["scale"], net(replace(one, third=None), 2).numbers["scale"])


@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_threads_change_no_byte(net: PoseGaussianNetwork, precision: str) -> None:
    views, found = with_third(random_views(1)), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
                found.append(net(views, 2, only_last=True))
    finally:
        torch.set_num_threads(1)
    assert all(torch.equal(found[0].numbers[name], found[1].numbers[name]) for name in found[0].numbers)
    assert torch.equal(found[0].disparities[0], found[1].disparities[0])


def test_a_network_of_pairs_has_nothing_of_it_and_refuses_a_third_view(
    monkeypatch: pytest.MonkeyPatch, rig: Rig, shown: dict[int, SourceView]
) -> None:
    """Off is not computed: no third view is cut, nothing is warped,
    and names and shapes of weights are those without."""
    plain, more = network(), network(further_views=True)
    assert plain.state_dict().keys() == more.state_dict().keys()
    differing = [k for k, v in plain.state_dict().items() if v.shape != more.state_dict()[k].shape]
    assert differing == ["refinement.update.motion.correlation.0.weight"]
    with pytest.raises(ValueError, match="further_views=True"):
        plain(with_third(random_views(1)), 1)
    for name in (
        "posegaussian.stages.network.inference.third_of",
        "posegaussian.stages.network.model.refine.warped_correlation",
    ):
        monkeypatch.setattr(name, lambda *a: pytest.fail("computed for a network of pairs"))
    assert look(plain, Looks.of(rig, (0, 1, 2), 1), shown, 1, "float32").keys() == shown.keys()


def test_a_preset_says_it_and_one_written_before_is_without() -> None:
    more = replace(PRESETS["fast"], further_views=True)
    assert Preset.from_json(more.as_json()) == more
    old = json.loads(PRESETS["fast"].as_json())
    assert old.pop("further_views") is False
    assert Preset.from_json(json.dumps(old)) == PRESETS["fast"]


@pytest.mark.parametrize("name", list(PRESETS))
def test_it_costs_what_the_table_says(name: str) -> None:
    """Features of a third view of 256 px, and reading what is looked up in 8 iterations of both directions, a
    multiply-add being 2."""
    with FakeTensorMode(allow_non_fake_inputs=True), torch.no_grad(), FlopCounterMode(display=False) as counter:
        whole = PoseGaussianNetwork(replace(PRESETS[name], further_views=True))
        whole._further(
            Third(torch.zeros(1, 3, 256, 256), torch.zeros(1, 17, 64, 64), torch.zeros(2, 3, 4, dtype=torch.float64))
        )
    reads = whole.refinement.update.motion.correlation[0].weight
    added = len(reads) * 2 * (2 * PRESETS[name].correlation_radius + 1)
    assert added == FURTHER_COSTS[name].parameters
    assert reads.numel() - added == len(reads) * PRESETS[name].correlation_levels * (
        2 * PRESETS[name].correlation_radius + 1
    )
    operations = counter.get_total_flops() + 8 * 2 * 2 * added * (256 // PRESETS[name].stride) ** 2
    assert operations / 1e9 == pytest.approx(FURTHER_COSTS[name].gflop[256], rel=0.02)


def test_pairs_are_looked_at_however_their_baseline_runs() -> None:
    stacked = rig_of([camera(on_ring(0, e), np.zeros(3)) for e in (0, 30)])
    assert len(Looks.of(stacked, (0, 1), 2).pairs) == 1
    ring_on_its_side = rig_of([camera(on_ring(a), np.zeros(3), 90.0) for a in range(0, 360, 45)])
    assert len(Looks.of(ring_on_its_side, tuple(range(8)), 2).pairs) == 8
