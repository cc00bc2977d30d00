"""Compiled kernels: said when they are made. Which tiles they list, in what order, and where arrays begin."""

import dataclasses
import logging
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.cpu import backend, tiles
from posegaussian.stages.splatting.cpu.projection import DEPTH, RECORD, SLOT
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
    exact = len(backend.list_tiles(records, reaches, task, True)[2])
    boxes = sum((x1 - x0 + 1) * (y1 - y0 + 1) for x0, x1, y0, y1 in (tiles._box.py_func(reaches, i) for i in range(40)))
    assert exact < 0.8 * boxes
    agree(g, cam, picture=2e-3, gradient=2e-2)  # one threshold that flips is 1/255 of a pixel


@pytest.mark.parametrize("count", [300, 60], ids=["long lists", "short lists"])
def test_lists_are_in_order_of_depth_and_the_same_with_and_without_gradients(count: int) -> None:
    """Equal depths in the order of the input, by digits of either width; all in one tile, and spread over several."""
    g = cloud(count, seed=3, dtype=torch.float32)
    g.mean[count // 2 :, 2] = g.mean[: count - count // 2, 2]
    for size, focal in ((24, 20.0), (150, 160.0)):
        arrays, task = (
            [backend.flat(getattr(g, n)) for n in backend.ATTRIBUTES],
            backend.job(camera(size, size, focal), Cutoffs(), 3, 1),
        )
        trained, drawn = backend.prepare(arrays, task, True), backend.prepare(arrays, task, False)
        np.testing.assert_array_equal(trained.starts, drawn.starts)
        np.testing.assert_array_equal(trained.order, drawn.order)
        assert sorted(trained.slots.tolist()) == list(range(len(trained.order)))
        assert len(drawn.slots) == 0
        longest = int(np.diff(trained.starts).max())
        assert (longest >= tiles.LONG) == (count > tiles.LONG and size < 32)
        depths = trained.records.reshape(-1, RECORD)[:, DEPTH]
        for a, b in pairwise(trained.starts.tolist()):
            listed = trained.order[a:b].tolist()
            assert listed == sorted(listed, key=lambda i: (depths[i], i))


def test_arrays_begin_with_a_cache_line() -> None:
    """Records and slots are as long as a line, so each lies in one."""
    assert RECORD * 4 == SLOT * 4 == backend.CACHE_LINE
    for dtype in (np.float32, np.uint32, np.uint64):
        for size in (1, 1000, 100_000):
            array = backend._new("of a test", size, dtype)
            assert array.ctypes.data % backend.CACHE_LINE == 0
            assert (len(array), array.dtype) == (size, dtype)
            assert backend.scratch("of a test", size, dtype).ctypes.data % backend.CACHE_LINE == 0
