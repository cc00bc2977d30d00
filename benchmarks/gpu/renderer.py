"""The `gpu` back end: milliseconds and memory of a person's picture, and how near it comes to another back end.

The person is made of spheres, as many Gaussians of the same size as that of benchmarks/renderer/workloads.py. The other
cuts of the kernels' work (`Shape`) are tried at one size. It is compared with `cpu` where numba is there, else with
`reference` on the device, both in float32: thresholds flip for single contributions of 1/255, so beside the greatest
difference stands the mean. gsplat's times stand beside it where it imports and builds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch

from benchmarks.gpu.rows import SMALL, UNMEASURED, Row, Setup
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
SHAPES = (backend.SHAPE, backend.Shape(8, 8, 1), backend.Shape(8, 2, 1), backend.Shape(16, 4, 4))
SIZES = (512, 1024, 2048)
"""Px of the pictures."""
TRIED_AT = 1024
"""Px of the pictures at which other cuts are tried."""
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


def person(size: int, of: int = SOURCE) -> tuple[Gaussians, Camera]:
    """About 145,000 pixel-aligned float32 Gaussians of two source views of `of` px 45 degrees apart, and a camera in
    their middle."""
    target, parts = camera(0.0, size), []
    for degrees in (-22.5, 22.5):
        source = camera(degrees, of)
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

    def __init__(self, size: int, device: torch.device, of: int = SOURCE) -> None:
        gaussians, self.camera = person(size, of)
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


class Agreement(NamedTuple):
    """How far pictures and gradients lie from another back end's."""

    against: str
    most: float
    """Greatest difference in colour, sRGB 0..1."""
    mean: float
    gradient: float
    """The largest of the gradients' relative differences."""
    unlike: int
    """Gradients that differ between two runs, in any bit."""


def compared(size: int, device: torch.device, of: int = SOURCE) -> Agreement:
    """Of one picture of the person."""
    name, engine, home = other()
    work = Workload(size, device, of)
    there = work if home is None else Workload(size, torch.device(home), of)
    a, b = work.forward(ours)[0].cpu(), there.forward(engine)[0].cpu()
    gradients = [(x.cpu(), y.cpu()) for x, y in zip(work.both(ours), there.both(engine), strict=True)]
    unlike = sum(int((x.cpu() != y).sum()) for x, (y, _) in zip(work.both(ours), gradients, strict=True))
    apart = max(float((x - y).norm() / y.norm()) for x, y in gradients)
    return Agreement(name, float((a - b).abs().max()), float((a - b).abs().mean()), apart, unlike)


def rows(setup: Setup) -> Iterator[Row]:
    """Ours and gsplat at every size, other cuts at one."""
    if lacking := backend.lacks(setup.device):
        yield Row("renderer", "", f"{UNMEASURED}: {lacking}")
        return
    theirs, why = gsplat_on(setup)
    of, usual = setup.px(SOURCE), backend.SHAPE
    for size in SIZES:
        side = f"{size} px"
        yield from agreement(compared(setup.px(size), setup.device, of), side)
        work = Workload(setup.px(size), setup.device, of)
        yield from timings(work, ours, "renderer", side, setup)
        if theirs:
            yield from timings(work, theirs, "gsplat", side, setup)
        else:
            yield Row("gsplat", side, why)
        for shape in SHAPES[1:] if size == TRIED_AT else ():
            backend.SHAPE = shape
            name = f"renderer, tile {shape.tile}, chunk {shape.chunk}, warps {shape.warps}"
            yield from timings(work, ours, name, side, setup)
        backend.SHAPE = usual


def agreement(found: Agreement, side: str) -> Iterator[Row]:
    """Its rows."""
    beside = f"renderer beside `{found.against}`"
    yield Row(f"{beside}: greatest difference", side, found.most, "sRGB 0..1")
    yield Row(f"{beside}: mean difference", side, 1e6 * found.mean, "1e-6")
    yield Row(f"{beside}: gradients' relative difference", side, 1e6 * found.gradient, "1e-6")
    yield Row("renderer: gradients that differ between two runs", side, float(found.unlike), wrong=found.unlike > 0)


def timings(work: Workload, engine: Engine, name: str, side: str, setup: Setup) -> Iterator[Row]:
    """Of a picture without gradients, and with all of them."""
    forward, _ = setup.timed(lambda: work.forward(engine))
    both, memory = setup.timed(lambda: work.both(engine))
    yield Row(f"{name}: a picture", side, forward, "ms", setup.name)
    yield Row(f"{name}: a picture and its gradients", side, both, "ms", setup.name)
    yield Row(f"{name}: memory of these", side, memory, "MiB", setup.name)


def gsplat_on(setup: Setup) -> tuple[Engine | None, str]:
    """gsplat, or why it does not draw on the device."""
    try:
        theirs = by_gsplat()
    except ImportError:
        return None, "gsplat is not installed"
    if setup.small:
        return None, UNMEASURED
    try:
        g, cam = person(SMALL, SMALL)
        theirs(placed(g, setup.device, False), cam)
    except Exception as e:  # its build fails in many ways, none of them ours
        return None, f"gsplat does not draw here: {type(e).__name__}: {str(e).partition(chr(10))[0]}"
    return theirs, ""
