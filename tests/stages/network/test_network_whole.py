"""Laws of the whole network: the start at a confidence of 0, unknown stays unknown, neighbours and threads change
nothing, costs as stated."""

from dataclasses import fields, replace

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.heads import trust
from posegaussian.stages.network.model.network import PoseGaussianNetwork, Prediction
from posegaussian.stages.network.model.pairs import MAPS, PairViews
from posegaussian.stages.network.model.presets import COSTS, PRESETS
from tests.support.network_views import network, random_views

torch.set_num_threads(1)


def outputs(p: Prediction) -> dict[str, torch.Tensor]:
    """Everything that a prediction holds, by name."""
    steps = {f"step {i}": d for i, d in enumerate(p.disparities)}
    return {**steps, **p.numbers, "trust": p.trust, "change": p.change, "disparity": p.disparity, "joint": p.joint}


def assert_same_bytes(a: Prediction, b: Prediction, rows: slice = slice(None)) -> None:
    for name, x in outputs(a).items():
        y = outputs(b)[name]
        assert torch.equal(x[rows].nan_to_num(nan=-7e7), y[rows].nan_to_num(nan=-7e7)), (
            f"{name} differs by {float((x[rows] - y[rows]).abs().nan_to_num().max()):g}"
        )


@pytest.fixture(scope="module")
def shaken() -> PoseGaussianNetwork:
    return network()


@pytest.fixture(scope="module")
def views() -> PairViews:
    return random_views(2)


@pytest.fixture(scope="module")
def said(shaken: PoseGaussianNetwork, views: PairViews) -> Prediction:
    return shaken(views, 3)


def test_shares_of_0_are_the_start_to_the_bit(
    shaken: PoseGaussianNetwork, views: PairViews, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.network.model.network.trust", lambda x: torch.zeros_like(x))
    found = shaken(views, 1)
    assert bool(found.change.any())
    assert torch.equal(found.disparity[views.known], views.start[views.known])


def test_an_untrained_network_moves_by_what_the_cells_lose_alone(views: PairViews) -> None:
    """Its heads are 0, the refinement stays at the start's cells:
    half of what a cell of 8 px blurs, by a confidence and shares of sigmoid(1)."""
    plain = network(shaken=False)(views, 2)
    for name, x in plain.numbers.items():
        assert bool(x.any()) == (name in ("confidence", "shares"))
    for said in (plain.confidence, plain.shares):
        torch.testing.assert_close(said, torch.full_like(said, torch.sigmoid(torch.tensor(1.0))))
    assert torch.equal(plain.disparities[0], plain.disparities[1])
    known = views.known
    torch.testing.assert_close(plain.change[known], (plain.disparities[-1] - views.start)[known] / 2)


def test_what_has_no_start_gets_none_and_all_else_is_finite(said: Prediction, views: PairViews) -> None:
    assert torch.equal(torch.isfinite(said.disparity), views.known)
    for name, x in outputs(said).items():
        assert name == "disparity" or torch.isfinite(x).all(), name
    low, high = (b[:, None, None, None] for b in views.coding.bounds())
    assert all(((d >= low - 1e-3) & (d <= high + 1e-3)).all() for d in said.disparities)


def test_a_pair_without_any_start_is_finite(shaken: PoseGaussianNetwork) -> None:
    views = random_views(1)
    nothing = replace(
        views, start=torch.full_like(views.start, torch.nan), confidence=torch.zeros_like(views.confidence)
    )
    found = shaken(nothing, 1)
    assert not torch.isfinite(found.disparity).any()
    assert all(torch.isfinite(x).all() for name, x in outputs(found).items() if name != "disparity")


def test_neighbours_in_the_batch_change_nothing(
    shaken: PoseGaussianNetwork, said: Prediction, views: PairViews
) -> None:
    other = random_views(2, seed=1)
    mixed = PairViews(
        *(torch.cat([getattr(views, name)[:2], getattr(other, name)[2:]]) for name in MAPS),
        Coding(
            *(torch.cat([getattr(views.coding, f.name)[:2], getattr(other.coding, f.name)[2:]]) for f in fields(Coding))
        ),
    )
    found = shaken(mixed, 3)
    assert_same_bytes(said, found, slice(0, 2))
    assert not torch.equal(said.numbers["scale"][2:], found.numbers["scale"][2:])


def test_both_directions_see_each_other(shaken: PoseGaussianNetwork, said: Prediction, views: PairViews) -> None:
    color = views.color.clone()
    color[1] = 1 - color[1]
    found = shaken(replace(views, color=color), 3)
    assert not torch.equal(said.disparities[-1][0], found.disparities[-1][0])
    assert_same_bytes(said, found, slice(2, 4))


def test_the_first_iterations_do_not_know_how_many_follow(
    shaken: PoseGaussianNetwork, said: Prediction, views: PairViews
) -> None:
    short = shaken(views, 2)
    assert len(said.disparities) == 3
    assert all(torch.equal(a, b) for a, b in zip(short.disparities, said.disparities, strict=False))
    last = shaken(views, 3, only_last=True)
    assert len(last.disparities) == 1
    assert torch.equal(last.disparities[0], said.disparities[-1])
    assert torch.equal(last.disparity[views.known], said.disparity[views.known])


def test_sizes_that_hold_no_whole_cells_and_no_iterations_are_refused(
    shaken: PoseGaussianNetwork, views: PairViews
) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        shaken(views, 0)
    odd = PairViews(*(getattr(views, name)[..., : (15 if name == "heatmaps" else 60)] for name in MAPS), views.coding)
    with pytest.raises(ValueError):
        shaken(odd, 1)


def test_bfloat16_is_close_to_float32(shaken: PoseGaussianNetwork, said: Prediction, views: PairViews) -> None:
    with torch.autocast("cpu", torch.bfloat16):
        found = shaken(views, 3)
    for name, x in outputs(found).items():
        assert name == "joint" or x.dtype == torch.float32, name
    # layers of 8 bits: a hundredth of what is said; starts of 300 px are exact, or the move would drown
    move, other = (torch.where(views.known, p.disparity - views.start, 0) for p in (said, found))
    assert float((move - other).abs().mean()) < 0.1 * float(move.abs().mean()) + 0.01
    assert float((trust(said.numbers["confidence"]) - trust(found.numbers["confidence"])).abs().max()) < 0.05


@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_threads_change_no_byte(shaken: PoseGaussianNetwork, views: PairViews, precision: str) -> None:
    found = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
                found.append(shaken(views, 2, only_last=True))
    finally:
        torch.set_num_threads(1)
    assert_same_bytes(found[0], found[1])


@pytest.mark.parametrize("name", list(PRESETS))
def test_parameters_and_operations_are_those_of_the_table(name: str) -> None:
    """To a hundredth: one pair at 256 px, both directions, 8 iterations.
    Nothing is computed: tensors without values."""
    coding = random_views(1, 8).coding
    with FakeTensorMode(allow_non_fake_inputs=True):
        whole = PoseGaussianNetwork(PRESETS[name])
        shapes = {
            "color": (2, 3, 256, 256),
            "heatmaps": (2, 17, 64, 64),
            "start": (2, 1, 256, 256),
            "confidence": (2, 1, 256, 256),
            "cover": (2, 1, 256, 256),
        }
        with torch.no_grad(), FlopCounterMode(display=False) as counter:
            whole(PairViews(*(torch.zeros(s) for s in shapes.values()), coding), 8, only_last=True)
    assert sum(p.numel() for p in whole.parameters()) == pytest.approx(COSTS[name].parameters, rel=0.01)
    # rounded to 1 of at least 22
    assert counter.get_total_flops() / 1e9 == pytest.approx(COSTS[name].gflop[256], rel=0.03)
