"""The `gpu` back end on a GPU: milliseconds and memory of a person's picture, and how near it comes to another back
end.

    python -m benchmarks.renderer.gpu_speed [--repeats 50] [--device cuda:0]

Needs torch, Triton and numpy, and nothing else of the repository's dependencies: the person is made of spheres here, as
many Gaussians of the same size as that of benchmarks/renderer/workloads.py. Times are medians between CUDA events,
after warming up; "f" is a picture without gradients, "f+b" one with all of them. Each row is one way to cut the
kernels' work. It is compared with
`cpu` where numba is there, else with `reference` on the device, both in float32: thresholds flip for single
contributions of 1/255, so beside the maximum stands the mean. gsplat's times are printed where it imports and builds.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from benchmarks.report import publish
from posegaussian.stages.gaussians.prior import normals, scales
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition import reference
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from posegaussian.stages.splatting.gpu import backend

SOURCE, ZOOM, DISTANCE, FOOTPRINT = 512, 1.9, 2.4, 1.03
"""Of the source pictures, as in benchmarks/renderer/workloads.py: side px, focal length over width, metres, standard
deviation in px."""
LIMBS = (
    ((0, 0, 1.80), (0, 0, 1.83), 0.11), ((0, 0, 1.10), (0, 0, 1.50), 0.16), ((0, -0.1, 1.0), (0, 0.1, 1.0), 0.15),
    ((0, -0.16, 1.50), (0, 0.16, 1.50), 0.08),
    ((0, 0.22, 1.48), (0.1, 0.48, 1.40), 0.055), ((0.1, 0.48, 1.40), (0.2, 0.55, 1.68), 0.05),
    ((0, -0.22, 1.48), (0.05, -0.35, 1.15), 0.055), ((0.05, -0.35, 1.15), (0.15, -0.38, 0.88), 0.05),
    ((0, 0.11, 0.95), (0.05, 0.15, 0.50), 0.085), ((0.05, 0.15, 0.50), (0, 0.16, 0.08), 0.065),
    ((0, -0.11, 0.95), (0.02, -0.14, 0.50), 0.085), ((0.02, -0.14, 0.50), (-0.05, -0.16, 0.08), 0.065),
)  # fmt: skip
"""Ends and radius of each, metres; the body stands along z."""
GIRTH = 0.76
"""Of the radii, so that the body fills 27 % of a source picture."""
SHAPES = (
    backend.SHAPE,
    backend.Shape(8, 4, 1),
    backend.Shape(8, 8, 2),
    backend.Shape(16, 4, 2),
    backend.Shape(16, 8, 4),
    backend.Shape(16, 8, 8),
)
WARM_UP = 5
Engine = Callable[[Gaussians, Camera], tuple[torch.Tensor, torch.Tensor]]
"""(colour [h, w, 3], alpha [h, w]) of Gaussians and a camera."""


def camera(degrees: float, size: int) -> Camera:
    """On a ring about the body, looking at its middle."""
    a = np.radians(degrees)
    centre, target = np.array([DISTANCE * np.cos(a), DISTANCE * np.sin(a), 1.2]), np.array([0.0, 0.0, 1.15])
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    return Camera(
        np.array([[ZOOM * size, 0.0, size / 2], [0.0, ZOOM * size, size / 2], [0.0, 0.0, 1.0]]), pose, size, size
    )


def seen(cam: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(depth [h, w] metres, 0 where nothing is; colour [h, w, 3]) of the body of spheres."""
    k, pose = np.asarray(cam.intrinsics), np.asarray(cam.world_to_camera)
    at = np.arange(cam.width) + 0.5
    x, y = np.meshgrid((at - k[0, 2]) / k[0, 0], (at - k[1, 2]) / k[1, 1])
    length = x * x + y * y + 1
    depth = np.full(x.shape, np.inf)
    for a, b, radius in LIMBS:
        for t in np.linspace(0, 1, 12):
            c = pose[:3, :3] @ ((1 - t) * np.array(a) + t * np.array(b)) + pose[:3, 3]
            r = GIRTH * radius
            middle, reach = (k @ c)[:2] / c[2], 1.1 * k[0, 0] * r / (c[2] - r) + 1
            box = tuple(slice(max(int(m - reach), 0), max(int(m + reach), 0)) for m in middle[::-1])
            along = x[box] * c[0] + y[box] * c[1] + c[2]
            root = along * along - length[box] * (c @ c - r * r)
            depth[box] = np.where(
                root > 0, np.minimum(depth[box], (along - np.sqrt(np.maximum(root, 0))) / length[box]), depth[box]
            )
    depth = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
    color = 0.5 + 0.4 * np.stack([np.sin(40 * x), np.sin(30 * y + 1), np.cos(50 * (x + y))], axis=2)
    return depth, color.astype(np.float32)


def person(size: int) -> tuple[Gaussians, Camera]:
    """About 145,000 pixel-aligned float32 Gaussians of two source views 45 degrees apart,
    and a camera in their middle."""
    target, parts = camera(0.0, size), []
    for degrees in (-22.5, 22.5):
        source = camera(degrees, SOURCE)
        depth, color = seen(source)
        k = np.asarray(source.intrinsics)
        normal = normals(depth, k)
        face_on = np.where(depth > 0, np.float32(0.99), np.float32(0))
        maps = GaussianMaps(
            color, depth, scales(depth, normal, k, FOOTPRINT, 0.1, 0.5), normal, np.stack([face_on, 0.8 * face_on])
        )
        parts.append(
            lift(maps, k, np.asarray(source.world_to_camera), torch.float32, torch.device("cpu")).seen_from(target)
        )
    return Gaussians.concatenate(parts), target


def placed(g: Gaussians, device: torch.device, gradients: bool) -> Gaussians:
    """A copy on the device."""
    return Gaussians(
        *(getattr(g, n).detach().to(device, copy=True).requires_grad_(gradients) for n in backend.ATTRIBUTES)
    )


class Workload:
    """One picture of the person, ready to be drawn by any engine."""

    def __init__(self, size: int, device: torch.device) -> None:
        gaussians, self.camera = person(size)
        self.name, self.device = f"person{size}", device
        self.fixed, self.leaves = placed(gaussians, device, False), placed(gaussians, device, True)
        rng = np.random.default_rng(0)
        self.up = [
            torch.as_tensor(rng.normal(size=s), dtype=torch.float32, device=device)
            for s in ((size, size, 3), (size, size))
        ]

    def forward(self, engine: Engine) -> tuple[torch.Tensor, torch.Tensor]:
        with torch.no_grad():
            return engine(self.fixed, self.camera)

    def both(self, engine: Engine) -> list[torch.Tensor]:
        return list(
            torch.autograd.grad(
                list(engine(self.leaves, self.camera)),
                [getattr(self.leaves, n) for n in backend.ATTRIBUTES],
                self.up,
                allow_unused=True,
                materialize_grads=True,
            )
        )

    def row(self, name: str, engine: Engine, repeats: int) -> dict[str, Any]:
        f, f_memory = timed(lambda: self.forward(engine), repeats, self.device)
        fb, fb_memory = timed(lambda: self.both(engine), repeats, self.device)
        return {
            "scene": self.name,
            "engine": name,
            "Gaussians": len(self.fixed),
            "f ms": f,
            "f+b ms": fb,
            "f MiB": f_memory,
            "f+b MiB": fb_memory,
        }


def timed(work: Callable[[], Any], repeats: int, device: torch.device) -> tuple[float, float]:
    """(median milliseconds, MiB allocated at the peak beyond what was there before)."""
    for _ in range(WARM_UP):
        work()
    torch.cuda.synchronize(device)
    before = torch.cuda.memory_allocated(device)
    torch.cuda.reset_peak_memory_stats(device)
    times = []
    for _ in range(repeats):
        start, stop = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        work()
        stop.record()
        stop.synchronize()
        times.append(start.elapsed_time(stop))
    return statistics.median(times), (torch.cuda.max_memory_allocated(device) - before) / 2**20


def ours(g: Gaussians, cam: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    return backend.render(g, cam, Cutoffs(), 3)[:2]


def plain(g: Gaussians, cam: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    picture, _ = reference.composite(g, cam, Cutoffs())
    return picture[..., :3], picture[..., 3]


def other() -> tuple[str, Engine, str | None]:
    """(name, engine, device: None for the workload's) of what the pictures are compared with."""
    try:
        from posegaussian.stages.splatting.cpu import backend
    except ImportError:
        return "reference", plain, None
    return "cpu", lambda g, cam: backend.render(g, cam, Cutoffs(), 3, 1)[:2], "cpu"


def by_gsplat() -> Engine:
    """The rasterizer of gsplat with its own alpha cap and stop. Raises whatever its import or build raises."""
    from gsplat import rasterization

    def engine(g: Gaussians, cam: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        k, pose = (
            torch.as_tensor(np.asarray(m), dtype=torch.float32, device=g.mean.device)[None]
            for m in (cam.intrinsics, cam.world_to_camera)
        )
        turn = quaternions(g.rotation.detach())
        picture, alpha, _ = rasterization(
            g.mean,
            turn,
            g.scale,
            g.opacity,
            g.color,
            pose,
            k,
            cam.width,
            cam.height,
            near_plane=0.01,
            eps2d=0.0,
            packed=False,
        )
        return picture[0], alpha[0, ..., 0]

    return engine


def quaternions(r: torch.Tensor) -> torch.Tensor:
    """[N, 4] (w, x, y, z) of rotations [N, 3, 3]: the longest row of the symmetric matrix 4 q q^T."""
    d = r.diagonal(dim1=1, dim2=2)
    w = 1 + d.sum(dim=1)
    own = 1 + 2 * d - d.sum(dim=1, keepdim=True)
    a, b, c = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    p, q, s = r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] + r[:, 1, 2]
    rows = torch.stack([w, a, b, c, a, own[:, 0], p, q, b, p, own[:, 1], s, c, q, s, own[:, 2]], dim=1).reshape(
        -1, 4, 4
    )
    best = rows.diagonal(dim1=1, dim2=2).argmax(dim=1)
    return torch.nn.functional.normalize(rows[torch.arange(len(r), device=r.device), best], dim=1)


def compared(work: Workload) -> dict[str, float | str]:
    """How far pictures and gradients lie from another back end's."""
    name, engine, device = other()
    there = work if device is None else Workload(work.camera.width, torch.device(device))
    a, b = work.forward(ours)[0].cpu(), there.forward(engine)[0].cpu()
    gradients = [(x.cpu(), y.cpu()) for x, y in zip(work.both(ours), there.both(engine), strict=True)]
    again = all(torch.equal(x.cpu(), y) for x, (y, _) in zip(work.both(ours), gradients, strict=True))
    return {
        "scene": work.name, "against": name, "picture max": float((a - b).abs().max()),
        "picture mean 1e-6": 1e6 * float((a - b).abs().mean()),
        "gradient 1e-6": 1e6 * max(float((x - y).norm() / y.norm()) for x, y in gradients),
        "two runs alike": str(again),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args()
    device = torch.device(options.device)
    if not torch.cuda.is_available() or backend.lacks(device):
        print(
            "Nothing measured: "
            + (
                backend.lacks(device)
                if torch.cuda.is_available()
                else f"torch {torch.__version__} finds no CUDA device here"
            )
            + "."
        )
        return
    try:
        theirs: Engine | None = by_gsplat()
        theirs(*tiny(device))
    except Exception as e:  # its build fails in many ways, none of them ours
        print(f"gsplat is left out: {type(e).__name__}: {e}")
        theirs = None
    rows, agreement = [], []
    for size in (512, 1024):
        work = Workload(size, device)
        agreement.append(compared(work))
        for shape in SHAPES:
            backend.SHAPE = shape
            rows.append(
                work.row(f"gpu, tile {shape.tile}, chunk {shape.chunk}, warps {shape.warps}", ours, options.repeats)
            )
        backend.SHAPE = SHAPES[0]
        if theirs:
            rows.append(work.row("gsplat", theirs, options.repeats))
    versions = {
        "device": torch.cuda.get_device_name(device),
        "torch": torch.__version__,
        "triton": backend.triton_version(),
    }
    publish("gpu_renderer", rows, {"repeats": options.repeats, **versions, "agreement": agreement})
    for line in agreement:
        print(", ".join(f"{k} {v}" for k, v in line.items()))


def tiny(device: torch.device) -> tuple[Gaussians, Camera]:
    """The first thousand Gaussians, small: whether an engine runs at all."""
    g, cam = person(64)
    return placed(Gaussians(*(getattr(g, n)[:1000] for n in backend.ATTRIBUTES)), device, False), cam


if __name__ == "__main__":
    main()
