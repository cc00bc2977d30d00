"""Gaussians as numbers to optimise: what an offset means, and that maps and numbers say the same."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.refinement.steps.attributes import SharedGaussians, ViewGaussians
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.scene import Gaussians

K = np.array([[60.0, 0.7, 12], [0, 55, 10], [0, 0, 1]])
POSE = np.eye(4)


def maps(random: np.random.Generator, twist: bool) -> GaussianMaps:
    """A wall of Gaussians that lean, longer than wide."""
    normal = np.stack([*random.uniform(-0.4, 0.4, (2, 20, 24)), np.full((20, 24), -1.0)])
    angle = random.uniform(-np.pi, np.pi, (20, 24))
    return GaussianMaps(
        random.integers(0, 255, (20, 24, 3), dtype=np.uint8),
        random.uniform(1, 2, (20, 24)).astype(np.float32),
        random.uniform(0.01, 0.05, (3, 20, 24)).astype(np.float16),
        (normal / np.linalg.norm(normal, axis=0)).astype(np.float16),
        np.full((2, 20, 24), 0.5, np.float16),
        np.stack([np.cos(angle), np.sin(angle)]).astype(np.float16) if twist else None,
    )


@pytest.mark.parametrize("twist", [False, True])
def test_an_offset_turns_a_gaussian_about_its_normal_by_the_angle_whose_tangent_it_is(twist: bool) -> None:
    shared = SharedGaussians({0: ViewGaussians.of(maps(np.random.default_rng(1), twist), K, POSE)})
    before = shared.gaussians().rotation.detach().numpy()
    turn = np.random.default_rng(2).uniform(-2, 2, len(shared)).astype(np.float32)
    shared.offsets["twist"][0] = turn
    after = shared.gaussians().rotation.detach().numpy()
    # float32, of values up to 1
    np.testing.assert_allclose(after[:, :, 2], before[:, :, 2], atol=1e-6)
    np.testing.assert_allclose(after.transpose(0, 2, 1) @ after, np.broadcast_to(np.eye(3), after.shape), atol=3e-6)
    along, across = ((after[:, :, 0] * before[:, :, i]).sum(axis=1) for i in (0, 1))
    np.testing.assert_allclose(np.arctan2(across, along), np.arctan(turn), atol=1e-5)


@pytest.mark.parametrize("twist", [False, True])
def test_maps_say_what_the_numbers_say_turns_included(twist: bool) -> None:
    """Of an offset that turns, lifted again from the maps: within what float16 keeps of a cosine."""
    shared = SharedGaussians({0: ViewGaussians.of(maps(np.random.default_rng(1), twist), K, POSE)})
    shared.offsets["twist"][0] = np.random.default_rng(2).uniform(-2, 2, len(shared))
    own = shared.gaussians()
    again = lift(shared.lists()[0], K, POSE, torch.float32, torch.device("cpu"))
    np.testing.assert_allclose(again.rotation.numpy(), own.rotation.detach().numpy(), atol=2e-3)
    np.testing.assert_allclose(again.mean.numpy(), own.mean.detach().numpy(), atol=1e-5)


def test_a_shift_is_of_pixels_to_the_right_and_down_and_lists_say_it() -> None:
    """Of Gaussians that were shifted before: seen from the same camera each lies so many px beside where it was."""
    random = np.random.default_rng(6)
    given = replace(maps(random, True), shift=random.uniform(-2, 2, (2, 20, 24)).astype(np.float16))
    shared = SharedGaussians({0: ViewGaussians.of(given, K, POSE)})
    before = shared.gaussians().mean.detach().numpy() @ K.T
    shift = random.uniform(-2, 2, (2, len(shared))).astype(np.float32)
    shared.offsets["shift"][:] = shift
    after = shared.gaussians().mean.detach().numpy() @ K.T
    np.testing.assert_allclose(after[:, :2] / after[:, 2:] - before[:, :2] / before[:, 2:], shift.T, atol=1e-4)
    again = lift(shared.lists()[0], K, POSE, torch.float32, torch.device("cpu")).mean.numpy() @ K.T
    # float16 keeps up to 4 px to 0.002
    np.testing.assert_allclose(again[:, :2] / again[:, 2:], after[:, :2] / after[:, 2:], atol=3e-3)


def test_without_offsets_nothing_changes() -> None:
    given = maps(np.random.default_rng(3), True)
    found = SharedGaussians({0: ViewGaussians.of(given, K, POSE)}).lists()[0]
    given = given.listed()
    assert found.twist is not None
    assert given.twist is not None
    np.testing.assert_array_equal(found.depth, given.depth)
    np.testing.assert_array_equal(found.color, given.color)
    np.testing.assert_allclose(found.twist.astype(float), given.twist.astype(float), atol=1e-3)  # float16, made unit


def two_views(random: np.random.Generator) -> SharedGaussians:
    """Offsets of all kinds, of two cameras that stand apart and lean."""
    views = {}
    for view, angle in enumerate((0.0, 0.7)):
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        pose[:3, 3] = random.normal(size=3)
        views[view] = ViewGaussians.of(maps(random, True), K, pose)
    shared = SharedGaussians(views)
    for offsets in shared.offsets.values():
        offsets += random.uniform(-0.2, 0.2, offsets.shape).astype(np.float32)
    return shared


def by_torch(shared: SharedGaussians) -> tuple[Gaussians, dict[str, torch.Tensor]]:
    """The same Gaussians lifted view by view as rendering does, in float64, and the offsets they follow from."""
    offsets = {n: torch.from_numpy(o).double().requires_grad_() for n, o in shared.offsets.items()}
    parts, start = [], 0
    for view in shared.views.values():
        own = slice(start, start + len(view))
        o = {name: value[:, own] for name, value in offsets.items()}
        b = {name: torch.from_numpy(value).double() for name, value in view.base.items()}
        cosine, sine = torch.from_numpy(view.twist).double()
        opacity = torch.sigmoid(b["opacity"] + o["opacity"])
        down = o["shift"][1] / K[1, 1]
        right = (o["shift"][0] - K[0, 1] * down) / K[0, 0]
        rays = replace(view.pixels, x=view.pixels.x.double() + right, y=view.pixels.y.double() + down)
        lifted = rays.lift(
            (b["depth"] + o["depth"] * torch.from_numpy(view.footprint))[0],
            (b["rotation"] + o["rotation"]).unbind(0),
            torch.exp(b["scale"] + o["scale"]).T,
            opacity.T.expand(-1, 2),
            (b["color"] + o["color"]).T,
            (cosine - o["twist"][0] * sine, sine + o["twist"][0] * cosine),
        )
        parts.append(lifted.from_all_sides())
        start += len(view)
    return Gaussians.concatenate(parts), offsets


def test_gaussians_and_their_slopes_are_those_of_what_rendering_lifts() -> None:
    random = np.random.default_rng(4)
    shared = two_views(random)
    made, (wanted, offsets) = shared.gaussians(), by_torch(shared)
    torch.manual_seed(0)
    for name in vars(made):
        own, other = getattr(made, name), getattr(wanted, name)
        np.testing.assert_allclose(own.detach().numpy(), other.detach().numpy(), rtol=1e-5, atol=2e-6)  # float32
        slope = torch.randn(own.shape)
        own.backward(slope)
        other.backward(slope.double(), retain_graph=True)
    found = shared.slopes(made)
    for name, offset in offsets.items():
        assert offset.grad is not None
        # sums of up to nine terms of size 1 in float32, of which some cancel
        np.testing.assert_allclose(found[name], offset.grad.numpy(), rtol=1e-4, atol=2e-5, err_msg=name)


def test_what_has_no_length_or_no_reader_has_no_slope() -> None:
    given = maps(np.random.default_rng(5), True)
    given.normal[:, 3, 4] = 0
    shared = SharedGaussians({0: ViewGaussians.of(given, K, POSE)})
    made = shared.gaussians()
    at = 3 * 24 + 4
    np.testing.assert_array_equal(made.rotation[at, :, 2].detach().numpy(), [0, 0, -1])
    made.rotation.backward(torch.ones_like(made.rotation))
    found = shared.slopes(made)
    assert not found["rotation"][:, at].any()
    assert found["rotation"][:, at + 1].any()
    assert not any(found[name].any() for name in ("color", "scale", "opacity", "depth"))
