"""The GPU benchmark of the renderer on a machine that has none: what it would draw."""

import numpy as np
import pytest
import torch

from benchmarks.gpu import renderer
from posegaussian.stages.splatting.quaternions import rotations


def test_the_person_is_as_large_as_the_other_benchmarks() -> None:
    """There 143,909 Gaussians on 27 % of a source picture; a sphere's front is seen where its depth is."""
    cam = renderer.camera(-22.5, 256)
    depth, color = renderer.seen(cam)
    assert 4 * 2 * np.count_nonzero(depth) == pytest.approx(144_000, rel=0.05)
    assert 1.5 < depth[depth > 0].min() < depth.max() < 3.2
    assert color.shape == (256, 256, 3)


def test_quaternions_turn_as_their_rotations_do() -> None:
    turn = rotations(torch.as_tensor(np.random.default_rng(0).normal(size=(50, 4))))
    half_turns = torch.diag_embed(torch.tensor([[1.0, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=torch.float64))
    both = torch.cat([turn, half_turns])
    torch.testing.assert_close(rotations(renderer.quaternions(both)), both)
