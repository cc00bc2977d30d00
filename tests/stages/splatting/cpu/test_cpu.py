"""Compiled kernels: said when they are made. Which tiles they list."""

import dataclasses
import logging
from pathlib import Path

import pytest
import torch

from posegaussian.stages.splatting.cpu import backend, tiles
from posegaussian.stages.splatting.definition.scene import Cutoffs
from tests.hard_cases.laws import agree
from tests.support.gaussian_scenes import camera, cloud, draw, gaussians


def test_compiling_is_announced_once_and_only_where_nothing_is_compiled(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        backend.announce(tmp_path)
        backend.announce(tmp_path)
        assert len(caplog.messages) == 1
        assert "compiling the renderer" in caplog.messages[0]
        (tmp_path / "more").mkdir()
        (tmp_path / "more" / "projection.project-154.py311.1.nbc").touch()
        backend.announce(tmp_path / "more")
    assert len(caplog.messages) == 1


def test_s12_more_intersections_than_slots_have_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "MOST_INTERSECTIONS", 100)
    with pytest.raises(backend.TooLarge, match="intersections"):
        draw(gaussians([[0, 0, 2.0]] * 60, 10.0, dtype=torch.float32), camera())


def test_tiles_that_only_the_box_reaches_are_left_out_and_none_that_the_ellipse_reaches() -> None:
    """Long diagonal Gaussians over many tiles: the same pictures as without the exact test."""
    g = cloud(40, seed=5, dtype=torch.float32)
    g = dataclasses.replace(g, scale=g.scale * torch.tensor([20.0, 1.0, 1.0]))
    cam = camera(300, 260, 300.0)
    task = backend.job(cam, Cutoffs(), 3, 1)
    records, reaches, _ = backend.project([backend.flat(getattr(g, n)) for n in backend.ATTRIBUTES], task)
    exact = len(backend.list_tiles(records, reaches, task)[2])
    boxes = sum((x1 - x0 + 1) * (y1 - y0 + 1) for x0, x1, y0, y1 in (tiles._box.py_func(reaches, i) for i in range(40)))
    assert exact < 0.8 * boxes
    agree(g, cam, picture=2e-3, gradient=2e-2)  # one threshold that flips is 1/255 of a pixel
