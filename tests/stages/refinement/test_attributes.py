"""Gaussians as numbers to optimise: what an offset means, and that maps and numbers say the same."""

import numpy as np
import pytest
import torch

from posegaussian.stages.refinement.attributes import SharedGaussians, ViewGaussians
from posegaussian.stages.rendering.lift import GaussianMaps, lift

K = np.array([[60.0, 0, 12], [0, 60, 10], [0, 0, 1]])
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
    shared.arrays()["twist"][0] = turn
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
    shared.arrays()["twist"][0] = np.random.default_rng(2).uniform(-2, 2, len(shared))
    own = shared.gaussians()
    again = lift(shared.maps()[0], K, POSE, torch.float32, torch.device("cpu"))
    np.testing.assert_allclose(again.rotation.numpy(), own.rotation.detach().numpy(), atol=2e-3)
    np.testing.assert_allclose(again.mean.numpy(), own.mean.detach().numpy(), atol=1e-5)


def test_without_offsets_nothing_changes() -> None:
    given = maps(np.random.default_rng(3), True)
    found = SharedGaussians({0: ViewGaussians.of(given, K, POSE)}).maps()[0]
    assert found.twist is not None
    assert given.twist is not None
    np.testing.assert_array_equal(found.depth, given.depth)
    np.testing.assert_array_equal(found.color, given.color)
    np.testing.assert_allclose(found.twist.astype(float), given.twist.astype(float), atol=1e-3)  # float16, made unit
