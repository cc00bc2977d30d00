"""What every hard case is held to: finite in value and gradient, the compiled back end near float64,
derivatives near cut-offs."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians, Rendering
from posegaussian.stages.splatting.rasterizer import rasterize
from tests.support.gaussian_scenes import placed

FIELDS = tuple(Gaussians.__dataclass_fields__)
EXTRAS = ("depth", "normal")
Gradients = dict[str, torch.Tensor]


def to(g: Gaussians, dtype: torch.dtype) -> Gaussians:
    return Gaussians(*(getattr(g, name).to(dtype) for name in FIELDS))


def pictures(out: Rendering) -> list[torch.Tensor]:
    return [p for p in (out.color, out.alpha, out.depth, out.normal) if p is not None]


def weighted(out: Rendering) -> torch.Tensor:
    """A loss in which every value of every picture has its own weight."""
    rng = np.random.default_rng(0)
    return sum(
        ((p * torch.as_tensor(rng.normal(size=p.shape), dtype=p.dtype)).sum() for p in pictures(out)),
        torch.zeros((), dtype=out.alpha.dtype),
    )


def drawn(g: Gaussians, cam: Camera, cutoffs: Cutoffs | None = None, threads: int = 1) -> tuple[Rendering, Gradients]:
    """Pictures and gradients, after checking that every number of both is finite; float32 is drawn by the compiled
    back end that is tried, float64 by `reference`."""
    leaves = {name: getattr(g, name).clone().requires_grad_() for name in FIELDS}
    k, pose = (
        torch.tensor(np.asarray(m), dtype=torch.float64, requires_grad=True)
        for m in (cam.intrinsics, cam.world_to_camera)
    )
    there, backend = placed(Gaussians(**leaves))
    out = rasterize(
        there, [Camera(k, pose, cam.width, cam.height)], EXTRAS, Drawing(cutoffs or Cutoffs(), backend, threads)
    )
    assert out.backend == (backend if g.mean.dtype == torch.float32 else "reference")
    out = Rendering(*(p.cpu() for p in out[:4]), *out[4:])  # type: ignore[union-attr]
    for picture in pictures(out):
        assert torch.isfinite(picture).all()
    weighted(out).backward()
    gradients = {
        n: leaf.grad if leaf.grad is not None else torch.zeros_like(leaf)
        for n, leaf in {**leaves, "intrinsics": k, "pose": pose}.items()
    }
    for name, gradient in gradients.items():
        assert torch.isfinite(gradient).all(), name
    return out, gradients


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    """Distance of two gradients over the length of the second."""
    return float((a.double() - b.double()).norm() / b.double().norm().clamp(min=1e-6))


def agree(
    g: Gaussians, cam: Camera, cutoffs: Cutoffs | None = None, picture: float = 2e-5, gradient: float = 1e-5
) -> Rendering:
    """The compiled back end against float64 on the same float32 numbers; returns float64's pictures."""
    single = to(g, torch.float32)
    a, da = drawn(single, cam, cutoffs)
    b, db = drawn(to(single, torch.float64), cam, cutoffs)
    assert a.masked == b.masked
    for x, y in zip(pictures(a), pictures(b), strict=True):
        assert float((x - y).detach().abs().max()) < picture * max(1.0, float(y.detach().abs().max()))
    for name, value in db.items():
        assert relative(da[name], value) < gradient, name
    return b


def slope_error(g: Gaussians, cam: Camera, name: str, cutoffs: Cutoffs | None = None, step: float = 1e-7) -> float:
    """How far the float64 gradient lies from central differences along a random direction, over the difference where
    that is above 1.

    A step of 1e-7 stays on one side of a cut-off that is farther away than that.
    """
    gradients = drawn(g, cam, cutoffs)[1]
    direction = torch.as_tensor(np.random.default_rng(1).normal(size=getattr(g, name).shape))

    def loss(t: float) -> float:
        moved = dataclasses.replace(g, **{name: getattr(g, name) + t * direction})
        return float(weighted(rasterize(moved, [cam], EXTRAS, Drawing(cutoffs or Cutoffs()))))

    expected = float((gradients[name] * direction).sum())
    return abs((loss(step) - loss(-step)) / (2 * step) - expected) / max(1.0, abs(expected))


def derivative(g: Gaussians, cam: Camera, name: str, cutoffs: Cutoffs | None = None, step: float = 1e-7) -> None:
    """The float64 gradient is that of central differences."""
    assert slope_error(g, cam, name, cutoffs, step) < 1e-5
