"""Gradients through lifting to the maps of a source view: depth, normal, scale, opacity and colour, pixel by pixel."""

import dataclasses

import numpy as np
import pytest
import torch

from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.cameras import rigid
from tests.hard_cases.laws import relative

K = np.array([[20.0, 0.5, 8.3], [0, 21.0, 5.8], [0, 0, 1]])
H, W = 12, 16
NAMES = tuple(f.name for f in dataclasses.fields(GaussianMaps) if f.name != "places")


def source() -> dict[str, torch.Tensor]:
    """A wavy surface with a hole, float64."""
    rng = np.random.default_rng(0)
    depth = 2 + 0.1 * rng.normal(size=(H, W))
    depth[3:5, 6:9] = 0
    normal = np.stack([0.3 * rng.normal(size=(H, W)), 0.3 * rng.normal(size=(H, W)), -np.ones((H, W))])
    opacity = np.stack([rng.uniform(0.5, 0.9, (H, W)), rng.uniform(0.2, 0.6, (H, W))])
    turn = rng.uniform(-np.pi, np.pi, (H, W))
    parts = (
        rng.uniform(0, 1, (H, W, 3)),
        depth,
        rng.uniform(0.02, 0.08, (3, H, W)),
        normal,
        opacity,
        np.stack([np.cos(turn), np.sin(turn)]),
        rng.uniform(-0.5, 0.5, (2, H, W)),
    )
    return {n: torch.as_tensor(p) for n, p in zip(NAMES, parts, strict=True)}


def target() -> Camera:
    a = 0.15
    return Camera(
        K,
        rigid(np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]), np.array([0.3, 0.0, 0.1])),
        W,
        H,
    )


def loss(maps: dict[str, torch.Tensor], dtype: torch.dtype) -> torch.Tensor:
    lifted = lift(GaussianMaps(**maps), K, np.eye(4), dtype, torch.device("cpu"))
    out = rasterize(lifted.seen_from(target()), [target()], ("depth", "normal"))
    rng = np.random.default_rng(1)
    return sum(
        (
            (p * torch.as_tensor(rng.normal(size=p.shape), dtype=dtype)).sum()
            for p in (out.color, out.alpha, out.depth, out.normal)
        ),
        torch.zeros((), dtype=dtype),
    )  # type: ignore[union-attr]


def gradients(dtype: torch.dtype) -> dict[str, torch.Tensor]:
    maps = {n: m.to(torch.float32).to(dtype).requires_grad_() for n, m in source().items()}
    return dict(zip(NAMES, torch.autograd.grad(loss(maps, dtype), list(maps.values())), strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_gradient_of_a_map_equals_finite_differences(name: str) -> None:
    maps = source()
    values = maps[name].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(maps | {name: values}, torch.float64), values)
    # no surface appears
    direction = torch.as_tensor(np.random.default_rng(2).normal(size=values.shape)) * (maps[name] != 0)
    step = 1e-8
    with torch.no_grad():
        numeric = (
            loss(maps | {name: maps[name] + step * direction}, torch.float64)
            - loss(maps | {name: maps[name] - step * direction}, torch.float64)
        ) / (2 * step)
    expected = float((gradient * direction).sum())
    assert abs(float(numeric) - expected) < 1e-5 * max(1.0, abs(expected))


def test_compiled_gradients_of_maps_are_near_those_in_float64() -> None:
    single, double = gradients(torch.float32), gradients(torch.float64)
    for name in NAMES:
        assert relative(single[name], double[name]) < 3e-5, name


def test_pixels_without_surface_get_no_gradient() -> None:
    for name, g in gradients(torch.float32).items():
        hole = g[3:5, 6:9] if name in ("color", "depth") else g[:, 3:5, 6:9]
        assert torch.isfinite(g).all()
        assert not hole.any()
        assert g.any()
