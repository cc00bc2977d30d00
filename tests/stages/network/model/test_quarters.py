"""Laws of turned pictures: turning back undoes turning, the network sees them upright and says of them what it says of
the rectified ones, and compares along the pair's own rows."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.geometry.subject import up_direction
from posegaussian.stages.network.inference import Learned, along
from posegaussian.stages.network.model import refine
from posegaussian.stages.network.model.correlation import Correlation, columns_of
from posegaussian.stages.network.model.pairs import MAPS, PairViews
from posegaussian.stages.network.model.quarters import Quarters
from tests.support.known_geometry import camera, on_ring, rig_of
from tests.support.network_views import network, random_views

torch.set_num_threads(1)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_turning_back_undoes_turning(turn: int) -> None:
    maps, quarters = torch.rand(2, 3, 8, 12), Quarters((turn, turn))
    upright = quarters.upright(maps)
    assert upright.shape[2:] == ((12, 8) if turn % 2 else (8, 12))
    assert torch.equal(quarters.in_rows(upright), maps)
    assert (upright is maps) == (turn == 0), "what stands upright is not copied"


def test_a_batch_turns_each_by_its_own_if_it_is_square() -> None:
    maps, quarters = torch.rand(4, 2, 8, 8), Quarters((0, 0, 3, 3))
    upright = quarters.upright(maps)
    assert torch.equal(upright[:2], maps[:2])
    assert torch.equal(upright[2:], Quarters((3, 3)).upright(maps[2:]))
    assert torch.equal(quarters.in_rows(upright), maps)
    with pytest.raises(ValueError, match="8, 12"):
        quarters.upright(torch.rand(4, 2, 8, 12))


@pytest.mark.parametrize("first", [3, 4])
@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_what_is_said_along_upright_axes_is_turned_as_axes_in_a_picture_are(turn: int, first: int) -> None:
    """By the same law as between a rectified pair and its view, `along`, in which a quarter is a quarter."""
    said = np.random.default_rng(0).normal(size=(8, 1, 1)).astype(np.float32)
    zero = np.zeros((1, 1), np.float32)
    expected = along(Learned(zero, zero, zero, said), turn * np.pi / 2, first).numbers
    quarters, maps = Quarters((turn,)), torch.from_numpy(said)[None]
    found = quarters.along_rows(maps, (0, 1), signed=False)
    found = quarters.along_rows(found, (first, first + 1), signed=True)
    np.testing.assert_allclose(found[0], expected, atol=1e-6)  # the cosine of a quarter is 6e-17


def in_rows(views: PairViews, turn: int) -> PairViews:
    """Rectified pictures that look as the views do once they are turned upright."""
    quarters = Quarters((turn,) * len(views.start))
    return replace(views, **{n: quarters.in_rows(getattr(views, n)) for n in MAPS}, turned=quarters)


@pytest.mark.parametrize("rotation_head", ["normal", "quaternion"])
@pytest.mark.parametrize("turn", [1, 2, 3])
def test_of_views_alone_the_same_is_said_however_they_are_turned(turn: int, rotation_head: str) -> None:
    """Nothing is compared along rows, so that all else must be the same, to the bit, in its place."""
    net, views = network(alone=True, rotation_head=rotation_head), random_views(1)
    views = replace(views, alone=torch.ones(2, dtype=torch.bool))
    upright, found = net(views, 2), net(in_rows(views, turn), 2)
    quarters = Quarters((turn, turn))
    for name in ("disparity", "change", "trust", "confidence", "shares", "joint"):
        expected = quarters.in_rows(getattr(upright, name))
        assert torch.equal(getattr(found, name).nan_to_num(nan=-7e7), expected.nan_to_num(nan=-7e7)), name
    for mine, own in zip(found.disparities, upright.disparities, strict=True):
        assert torch.equal(mine, quarters.in_rows(own))
    scale = quarters.in_rows(upright.numbers["scale"])
    assert torch.equal(found.numbers["scale"], scale[:, [1, 0, 2]] if turn % 2 else scale)
    assert torch.equal(found.numbers["opacity"], quarters.in_rows(upright.numbers["opacity"]))


@pytest.mark.parametrize("rotation_head", ["normal", "quaternion"])
def test_gradients_are_the_same_however_pictures_are_turned(rotation_head: str) -> None:
    """Of a sum that no quarter changes; single precision adds in another order."""
    net, views = network(alone=True, rotation_head=rotation_head).requires_grad_(True), random_views(1)
    views = replace(views, alone=torch.ones(2, dtype=torch.bool))
    found = []
    for turn in range(4):
        said = net(in_rows(views, turn), 1)
        parts = [said.change.sum(), *(said.numbers[n].square().sum() for n in ("scale", "rotation", "opacity"))]
        used = torch.autograd.grad(sum(parts), tuple(net.parameters()), allow_unused=True)
        found.append(torch.cat([g.flatten() for g in used if g is not None]))
    assert float(found[0].abs().max()) > 0
    for turned in found[1:]:
        torch.testing.assert_close(turned, found[0], rtol=1e-3, atol=1e-4 * float(found[0].abs().max()))


def test_pairs_are_compared_along_their_own_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[torch.Tensor] = []

    class Noting(Correlation):
        def look_up(self, columns: torch.Tensor, coordinate_gradient: bool = False) -> torch.Tensor:
            asked.append(columns)
            return super().look_up(columns, coordinate_gradient)

    monkeypatch.setattr(refine, "Correlation", Noting)
    net, views = network(), random_views(1)
    wide = replace(views, **{n: getattr(views, n)[..., : getattr(views, n).shape[-2] // 2, :] for n in MAPS})
    net(replace(wide, turned=Quarters((3, 3))), 1)
    start = wide.coding.seeded(wide.start, net.preset.stride)
    assert start.shape[2] < start.shape[3]
    torch.testing.assert_close(asked[0], columns_of(start))


@pytest.mark.parametrize("roll", [0.0, 90.0, 200.0])
def test_turned_by_its_quarters_a_pair_shows_what_is_up_above(roll: float) -> None:
    """Cameras on a ring and above each other, all rolled alike: up is nearer to the columns than to the rows."""
    places = [[*on_ring(a)[:2], h] for a in (0.0, 25.0) for h in (-0.5, 0.0, 0.6)]
    rig = rig_of([camera(np.array(p), np.zeros(3), roll) for p in places])
    turned = set()
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            pair = rectify(rig, a, b, np.zeros(3))
            right, below, _ = pair.rotation @ up_direction(rig)
            # once counter-clockwise the right comes up and what was below lies to the right
            for _ in range(pair.quarters):
                right, below = below, -right
            assert below < 0
            assert abs(right) <= abs(below) + 1e-9
            turned.add(pair.quarters)
    assert {0, 3} <= turned
