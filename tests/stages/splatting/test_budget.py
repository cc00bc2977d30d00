"""Fewer Gaussians: never more than the budget, the same ones whatever their order, and nearly the same picture."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.budget import allowed, within_budget
from posegaussian.stages.splatting.clusters import clusters
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.cameras import rigid

NAMES = tuple(f.name for f in fields(Gaussians))
CAMERA = Camera(np.array([[60.0, 0, 32], [0, 60.0, 32], [0, 0, 1]]), rigid(np.eye(3), [0, 0, 2]), 64, 64)
"""At (0, 0, -2), so that a metre at the origin is 30 px."""


def cloud(n: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Gaussians:
    """Of any shape, within a metre."""
    rng = np.random.default_rng(seed)
    values = (
        rng.uniform(-0.5, 0.5, (n, 3)),
        rotations(torch.from_numpy(rng.normal(size=(n, 4)))).numpy(),
        rng.uniform(0.005, 0.03, (n, 3)),
        rng.uniform(0.05, 0.6, n),
        rng.uniform(0, 1, (n, 3)),
    )
    return Gaussians(*(torch.from_numpy(v).to(dtype) for v in values))


def wall(views: int = 1, noise: float = 0.0, side: int = 60) -> Gaussians:
    """A wall of a metre that faces the camera, left half dark and right half bright, seen by several views, a
    Gaussian a pixel; `noise` m of depth."""
    pitch, rng = 1 / side, np.random.default_rng(1)
    at = (np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) + 0.5) * pitch - 0.5
    parts = []
    for view in range(views):
        mean = np.column_stack([at + view * pitch / views, rng.normal(0, noise, len(at)) if noise else 0 * at[:, 0]])
        rotation = np.tile(np.diag([1.0, -1.0, -1.0]), (len(at), 1, 1))
        scale = np.tile([pitch / 2, pitch / 2, pitch / 20], (len(at), 1))
        color = np.where(mean[:, :1] < 0, 0.2, 0.8) * np.array([1, 0.9, 0.8])
        opacity = np.full(len(at), 0.99)
        parts.append(Gaussians(*(torch.from_numpy(v) for v in (mean, rotation, scale, opacity, color))))
    return Gaussians.concatenate(parts)


def picture(gaussians: Gaussians) -> np.ndarray:
    """[h, w, 4] colour and alpha of `CAMERA`."""
    drawn = rasterize(gaussians, [CAMERA])
    return torch.cat([drawn.color[0], drawn.alpha[0][..., None]], dim=2).numpy()


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(getattr(a, n).numpy().tobytes() == getattr(b, n).numpy().tobytes() for n in NAMES)


def at(gaussians: Gaussians, index: np.ndarray) -> Gaussians:
    return Gaussians(*(getattr(gaussians, n)[torch.from_numpy(index)] for n in NAMES))


def mass(g: Gaussians) -> torch.Tensor:
    """[N] optical mass."""
    return -torch.log1p(-g.opacity) * g.scale[:, 0] * g.scale[:, 1]


@pytest.mark.parametrize("budget", [0.001, 0.05, 0.3, 0.9, 2, 17, 499])
def test_there_are_never_more_than_the_budget(budget: float) -> None:
    gaussians = cloud(500, dtype=torch.float32)
    left = within_budget(gaussians, budget)
    assert 1 <= len(left) <= max(1, budget if budget > 1 else 500 * budget)
    assert left.mean.dtype == torch.float32
    turned = left.rotation.double().transpose(1, 2) @ left.rotation.double()
    torch.testing.assert_close(turned, torch.eye(3).double().expand_as(turned), rtol=0, atol=1e-6)
    torch.testing.assert_close(torch.linalg.det(left.rotation.double()), torch.ones(len(left)).double())


def test_the_whole_budget_is_used_where_nothing_is_said_twice() -> None:
    """The cloud's Gaussians lie further apart than they are large."""
    assert len(within_budget(cloud(500), 123)) == 123


@pytest.mark.parametrize("budget", [1.0, 500, 10_000])
def test_all_of_them_stay_as_they_are(budget: float) -> None:
    gaussians = cloud(500)
    assert same(within_budget(gaussians, budget), gaussians)


@pytest.mark.parametrize("budget", [0, -0.5, 1.5, float("nan"), float("inf")])
def test_budgets_that_say_nothing_are_refused(budget: float) -> None:
    with pytest.raises(ValueError, match="a share above 0 and up to 1, or a whole number"):
        allowed(10, budget)


def test_neither_the_order_nor_the_threads_change_a_byte() -> None:
    gaussians = wall(3, 0.002, side=30)
    first = within_budget(gaussians, 0.1)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    shuffled = at(gaussians, np.random.default_rng(5).permutation(len(gaussians)))
    again = within_budget(shuffled, 0.1)
    torch.set_num_threads(before)
    assert same(first, again)


@pytest.mark.parametrize(("opacity", "bound"), [(0.1, 0.003), (0.5, 0.07), (0.99, 0.26)])
def test_duplicates_become_one_of_nearly_their_picture(opacity: float, bound: float) -> None:
    """Two of opacity a and profile G cover 1 - (1 - a G)^2, one of their mass (2 a - a^2) G: at most a^2 / 4 apart."""
    one = replace(at(cloud(40, dtype=torch.float64), np.array([7])), opacity=torch.tensor([opacity]).double())
    two = Gaussians.concatenate([one, one])
    left = within_budget(two, 0.5)
    assert len(left) == 1
    torch.testing.assert_close(left.mean, one.mean, rtol=0, atol=1e-12)
    torch.testing.assert_close(left.color, one.color, rtol=0, atol=1e-12)
    np.testing.assert_allclose(left.opacity, 1 - (1 - opacity) ** 2, rtol=1e-6)
    torch.testing.assert_close(left.scale.sort().values, one.scale.sort().values, rtol=1e-6, atol=0)
    assert np.abs(picture(left) - picture(two)).max() <= bound


@pytest.mark.parametrize("budget", [0.5, 0.1, 1e-6])
def test_mass_and_its_mean_are_kept(budget: float) -> None:
    gaussians = cloud(300)
    gaussians = replace(gaussians, opacity=gaussians.opacity / 10)  # far from where opacity is bounded
    left = within_budget(gaussians, budget)
    torch.testing.assert_close(mass(left).sum(), mass(gaussians).sum(), rtol=1e-9, atol=0)
    means = [(g.mean * mass(g)[:, None]).sum(dim=0) / mass(g).sum() for g in (left, gaussians)]
    torch.testing.assert_close(means[0], means[1], rtol=0, atol=1e-9)


def test_a_wall_of_three_views_is_drawn_alike_by_a_tenth() -> None:
    """The full wall is opaque; the tenth lets a little through between its Gaussians, and softens the edge in the
    middle."""
    whole = wall(3, 0.001)
    inside = slice(20, 44), slice(20, 44)
    drawn, left = (picture(g)[inside] for g in (whole, within_budget(whole, 0.1)))
    assert drawn[..., 3].min() > 0.99
    assert left[..., 3].min() > 0.85
    assert left[..., 3].mean() > 0.92
    assert np.abs(drawn - left).mean() < 0.06


def test_detail_stays_and_the_flat_goes() -> None:
    """Of a wall whose right half is in random greys, most of what is left lies there."""
    flat = wall()
    right = (flat.mean[:, :1] > 0).double()
    grey = torch.from_numpy(np.random.default_rng(2).uniform(0, 1, (len(flat), 1)))
    left = within_budget(replace(flat, color=flat.color * (1 - right) + grey * right), 0.1)
    assert (left.mean[:, 0] > 0).double().mean() > 0.6


def test_normals_point_out_of_the_surface_and_thin_sides_stay_apart() -> None:
    """Of a sheet seen from both sides, half a Gaussian thick, neither side takes the other's colour."""
    front = wall(side=20)
    back = replace(
        front,
        mean=front.mean + torch.tensor([0, 0, 0.0125]),
        rotation=front.rotation @ torch.diag(torch.tensor([1.0, -1, -1])).double(),
        color=1 - front.color,
    )
    left = within_budget(Gaussians.concatenate([front, back]), 0.2)
    facing = left.rotation[:, 2, 2] < 0
    bright = (left.color[:, 0] > 0.5) == (left.mean[:, 0] > 0)
    assert 0.3 < facing.double().mean() < 0.7
    assert (left.rotation[:, 2, 2].abs() > 0.9).all()
    middle = left.mean[:, 0].abs() > 0.1
    assert (bright == facing)[middle].all()


def spoilt(what: str) -> Gaussians:
    """A cloud with something degenerate in it."""
    g = cloud(60, dtype=torch.float32)
    values = {n: getattr(g, n).clone() for n in NAMES}
    match what:
        case "zero opacity":
            values["opacity"][:50] = 0
        case "opaque":
            values["opacity"][:] = 1
        case "coincident":
            values["mean"][:] = 0.1
        case "identical":
            return at(g, np.zeros(60, int))
        case "huge":
            values["scale"][::2] = 3e38
            values["mean"][::3] = -3e38
        case "tiny":
            values["scale"][::2] = 1e-38
        case "flat":
            values["scale"][:, 2] = 1e-30
        case "not finite":
            values["mean"][0], values["color"][1], values["scale"][2] = torch.nan, torch.inf, torch.nan
    return Gaussians(**values)


KINDS = ("zero opacity", "opaque", "coincident", "identical", "huge", "tiny", "flat", "not finite")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("budget", [1e-9, 0.1, 0.5, 59])
@pytest.mark.parametrize("what", KINDS)
def test_degenerate_input_stays_finite(what: str, budget: float) -> None:
    left = within_budget(spoilt(what), budget)
    assert 1 <= len(left) <= allowed(60, budget)
    assert all(torch.isfinite(getattr(left, n)).all() for n in NAMES)
    assert (left.scale > 0).all()
    assert ((left.opacity > 0) & (left.opacity <= 1)).all()


def test_none_one_and_nothing_to_see() -> None:
    nothing, one = at(cloud(3), np.zeros(0, int)), at(cloud(3), np.array([1]))
    assert len(within_budget(nothing, 0.5)) == 0
    assert same(within_budget(one, 0.1), one)
    unseen = replace(cloud(3), opacity=torch.zeros(3, dtype=torch.float64))
    assert len(within_budget(unseen, 0.5)) == 0


def test_clusters_go_where_points_vary() -> None:
    """Ten points far apart and ninety close together: five clusters part the ten."""
    rng = np.random.default_rng(0)
    points = np.concatenate([100 * np.arange(10)[:, None], rng.uniform(0, 0.1, (90, 1)) + 2000])
    labels = clusters(points, np.ones(100), 5)
    assert len(np.unique(labels)) == 5
    assert len(np.unique(labels[10:])) == 1
    assert labels.min() == 0
    assert labels.max() == 4
    assert len(np.unique(clusters(points, np.ones(100), 100, enough=1.0))) == 11
    assert (clusters(points, np.ones(100), 1) == 0).all()
