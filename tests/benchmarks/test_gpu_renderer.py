"""The GPU benchmark on a machine that has none: what it would draw, and how it ends."""

import sys

import numpy as np
import pytest
import torch

from benchmarks.renderer import gpu_speed
from posegaussian.stages.splatting.quaternions import rotations


def test_the_person_is_as_large_as_the_other_benchmarks() -> None:
    """There 143,909 Gaussians on 27 % of a source picture; a sphere's front is seen where its depth is."""
    cam = gpu_speed.camera(-22.5, 256)
    depth, color = gpu_speed.seen(cam)
    assert 4 * 2 * np.count_nonzero(depth) == pytest.approx(144_000, rel=0.05)
    assert 1.5 < depth[depth > 0].min() < depth.max() < 3.2
    assert color.shape == (256, 256, 3)


def test_quaternions_turn_as_their_rotations_do() -> None:
    turn = rotations(torch.as_tensor(np.random.default_rng(0).normal(size=(50, 4))))
    half_turns = torch.diag_embed(torch.tensor([[1.0, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=torch.float64))
    both = torch.cat([turn, half_turns])
    torch.testing.assert_close(rotations(gpu_speed.quaternions(both)), both)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_device_it_ends_with_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu_speed"])
    gpu_speed.main()
    assert capsys.readouterr().out.startswith("Nothing measured: torch ")
