"""Small scenes for the rasterizer's tests."""

import math

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Backend, Camera, Cutoffs, Drawing, Gaussians, Rendering
from posegaussian.stages.splatting.gpu import backend as gpu
from posegaussian.stages.splatting.rasterizer import rasterize

GPU_DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
"""Where the `gpu` back end is tried."""
NO_GPU = gpu.lacks(GPU_DEVICE)
"""Why it cannot be, if so."""
COMPILED: list[Backend] = ["cpu", "gpu"] if NO_GPU is None else ["cpu"]
"""Back ends that draw float32 here."""
compiled: Backend = "cpu"
"""The one that is tried; see the fixture `each_compiled`."""


def camera(
    width: int = 48, height: int = 40, focal: float = 50.0, cx: float | None = None, cy: float | None = None
) -> Camera:
    """At the origin of the world, looking along +z."""
    k = np.array([[focal, 0, width / 2 if cx is None else cx], [0, focal, height / 2 if cy is None else cy], [0, 0, 1]])
    return Camera(k, np.eye(4), width, height)


def gaussians(
    mean: object,
    scale: object = 0.05,
    opacity: object = 0.8,
    color: object = (1.0, 0.5, 0.25),
    rotation: object = None,
    dtype: torch.dtype = torch.float64,
) -> Gaussians:
    """Everything broadcast to the number of means."""
    m = torch.as_tensor(mean, dtype=dtype).reshape(-1, 3)
    n = len(m)
    s = torch.as_tensor(scale, dtype=dtype)
    s = s.reshape(-1, 1) if s.ndim < 2 else s
    r = torch.eye(3, dtype=dtype) if rotation is None else torch.as_tensor(rotation, dtype=dtype)
    return Gaussians(
        m,
        r.expand(n, 3, 3).clone(),
        s.expand(n, 3).clone(),
        torch.as_tensor(opacity, dtype=dtype).expand(n).clone(),
        torch.as_tensor(color, dtype=dtype).expand(n, 3).clone(),
    )


def cloud(n: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Gaussians:
    """Random anisotropic Gaussians in front of `camera()`, drawn in float64 whatever the dtype."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(1.5, 4.0, n)
    mean = np.stack([rng.uniform(-0.5, 0.5, n) * z, rng.uniform(-0.4, 0.4, n) * z, z], axis=1)
    rotation = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    parts = (mean, rotation, rng.uniform(0.02, 0.2, (n, 3)), rng.uniform(0.1, 0.98, n), rng.uniform(0, 1, (n, 3)))
    return Gaussians(*(torch.as_tensor(p, dtype=dtype) for p in parts))


def turned_about_y(degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def draw(
    g: Gaussians,
    cam: Camera,
    cutoffs: Cutoffs | None = None,
    backend: Backend = "auto",
    extras: tuple[str, ...] = ("depth",),
    threads: int = 1,
) -> Rendering:
    """One camera's pictures without the axis of cameras; `masked` is a number."""
    g, backend = placed(g, backend)
    out = rasterize(g, [cam], extras, Drawing(cutoffs or Cutoffs(), backend, threads))
    return Rendering(*(None if p is None else p[0].cpu() for p in out[:4]), out.masked[0], out.backend)  # type: ignore[arg-type]


def placed(g: Gaussians, backend: Backend = "auto") -> tuple[Gaussians, Backend]:
    """Gaussians where the back end draws them, and the back end:
    `auto` is the compiled one that is tried, in float32."""
    if backend == "auto" and g.mean.dtype == torch.float32:
        backend = compiled
    return (
        Gaussians(*(getattr(g, name).to(GPU_DEVICE) for name in Gaussians.__dataclass_fields__))
        if backend == "gpu"
        else g
    ), backend
