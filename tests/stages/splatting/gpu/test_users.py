"""What draws or computes on a worker's device gives what it gives on the CPU, and gives it back there; the renderer in
Triton's interpreter where there is no GPU."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import torch

from posegaussian.stages.network.inference import predict
from posegaussian.stages.refinement import judging
from posegaussian.stages.splatting import rasterizer
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians, Rendering
from posegaussian.stages.splatting.gpu import backend
from tests.support.gaussian_scenes import NO_GPU, camera, cloud
from tests.support.network_views import network, random_views


def drawn(g: Gaussians, by: Callable[[Gaussians, Camera], Rendering]) -> tuple[str, list[torch.Tensor]]:
    """The back end that drew; picture, alpha, and gradients."""
    leaves = [getattr(g, f.name).clone().requires_grad_() for f in dataclasses.fields(g)]
    out = by(Gaussians(*leaves), camera(18, 13, 16.0))
    (out.color.sum() + 2 * out.alpha.sum()).backward()
    gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
    return out.backend, [out.color.detach(), out.alpha.detach(), *gradients]


@pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))
def test_a_step_of_refinement_is_drawn_on_the_device_and_back_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    g = cloud(30, seed=2, dtype=torch.float32)
    on_cpu, expected = drawn(g, lambda gaussians, cam: rasterizer.rasterize(gaussians, [cam]))
    if backend.interpreted():
        monkeypatch.setattr(rasterizer, "resolve", lambda name, gaussians: "gpu")
        monkeypatch.setattr(backend, "SHAPE", backend.Shape(tile=64, chunk=32))
    on_device, found = drawn(g, judging.draw)
    assert (on_cpu, on_device) == ("cpu", "gpu")
    assert len(found) == len(expected) == 7
    for a, b in zip(found, expected, strict=True):
        assert a.device.type == "cpu"
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_network_says_the_same_on_the_device_and_back_on_the_cpu() -> None:
    net, views = network().eval(), random_views(1)
    expected = predict(net, views, 3, "float32")
    # without TF32, whose products have ten bits
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        found = predict(net.to("cuda"), views, 3, "float32")
    for name in ("disparity", "trust", "confidence", "shares"):
        a, b = (getattr(p, name) for p in (found, expected))
        assert a.device.type == "cpu"
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3, equal_nan=True)


def test_a_prediction_is_moved_whole() -> None:
    """On the device that holds no numbers, so that any tensor left behind is seen without a GPU."""
    net = network().eval()
    there = predict(net, random_views(1), 1, "float32").to(torch.device("meta"))
    parts = [v for v in vars(there).values() if isinstance(v, torch.Tensor)]
    assert {t.device.type for t in (*parts, *there.disparities, *there.numbers.values())} == {"meta"}
    assert len(parts) >= 4
