"""The GPU back end against the reference, on a GPU or, without one, in Triton's interpreter.
Hard cases: tests/hard_cases."""

import dataclasses
import gc
import logging
import os
import subprocess
import sys
import weakref
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting import rasterizer
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians, TooLarge
from posegaussian.stages.splatting.gpu import backend
from posegaussian.stages.splatting.rasterizer import rasterize
from tests.hard_cases.extreme import scene
from tests.hard_cases.laws import FIELDS, drawn, pictures, relative, to
from tests.support import gaussian_scenes
from tests.support.gaussian_scenes import GPU_DEVICE, NO_GPU, camera, cloud, draw, gaussians
from tests.support.gsplat_reference import GSPLAT, reference_case

if NO_GPU is None:
    from posegaussian.stages.splatting.gpu import projection, tiles

needs_triton = pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))
QUICK = backend.Shape(tile=64, chunk=32)
"""Few programs: the interpreter takes as long for a pixel as for a thousand."""


@pytest.fixture
def on_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Float32 is drawn by `gpu`."""
    monkeypatch.setattr(gaussian_scenes, "compiled", "gpu")


@pytest.fixture
def quick(on_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    if backend.interpreted():
        monkeypatch.setattr(backend, "SHAPE", QUICK)


@needs_triton
@pytest.mark.usefixtures("on_gpu")
def test_pictures_and_gradients_of_a_scene_of_many_tiles_and_chunks() -> None:
    """With the tiles and chunks that a GPU gets; cameras included."""
    g, cam = cloud(30, seed=2, dtype=torch.float32), camera(18, 13, 16.0)
    (a, da), (_, db) = drawn(g, cam), drawn(to(g, torch.float64), cam)
    assert a.backend == "gpu"
    for x, y in zip(pictures(a), pictures(draw(g, cam, backend="reference", extras=("depth", "normal"))), strict=True):
        # the same projection in float32: a few roundings of numbers up to 4
        assert float((x[0] - y).detach().abs().max()) < 2e-6
    for name, value in db.items():
        assert relative(da[name], value) < 1e-5, name


@needs_triton
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("extras", [(), ("depth",), ("normal",)])
def test_what_is_not_asked_for_changes_nothing_of_the_rest(extras: tuple[str, ...]) -> None:
    g = cloud(20, dtype=torch.float32)
    some, every = draw(g, camera(), extras=extras), draw(g, camera(), extras=("depth", "normal"))
    assert (some.depth is None, some.normal is None) == ("depth" not in extras, "normal" not in extras)
    assert all(
        torch.allclose(a, b, rtol=0, atol=1e-6) for a, b in zip(some[:4], every[:4], strict=True) if a is not None
    )


@needs_triton
@pytest.mark.usefixtures("on_gpu")
@pytest.mark.parametrize("shape", [backend.Shape(4, 4), backend.Shape(16, 16, 8), backend.Shape(8, 2)])
def test_tiles_and_chunks_change_nothing_but_rounding(shape: backend.Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opaque Gaussians, so that pixels stop within chunks and between them."""
    # the compiler would unroll the interpreter's shape for minutes
    monkeypatch.setattr(backend, "SHAPE", QUICK if backend.interpreted() else backend.Shape())
    g, cam = (
        dataclasses.replace(
            cloud(12, dtype=torch.float32), opacity=torch.full((12,), 0.98), scale=torch.full((12, 3), 0.3)
        ),
        camera(7, 6, 7.0),
    )
    one, gradients = drawn(g, cam)
    monkeypatch.setattr(backend, "SHAPE", shape)
    other, others = drawn(g, cam)
    # depths up to 4
    assert all(torch.allclose(a, b, rtol=0, atol=2e-6) for a, b in zip(pictures(one), pictures(other), strict=True))
    assert all(relative(gradients[n], others[n]) < 1e-5 for n in gradients)


@needs_triton
@pytest.mark.usefixtures("on_gpu")
def test_two_runs_give_the_same_bits() -> None:
    g, cam = cloud(25, dtype=torch.float32), camera(12, 7, 10.0)
    (a, da), (b, db) = drawn(g, cam), drawn(g, cam)
    assert all(torch.equal(x, y) for x, y in zip(pictures(a), pictures(b), strict=True))
    assert all(torch.equal(da[n], db[n]) for n in da)


@needs_triton
@pytest.mark.usefixtures("quick")
def test_attributes_in_any_layout_and_matrices_on_the_device() -> None:
    """Transposed and expanded attributes, float32 matrices beside them: the same picture, and gradients as they were
    given."""
    g, cam = cloud(12, dtype=torch.float32), camera()
    g = dataclasses.replace(g, opacity=torch.full((12,), 0.7))
    plain = draw(g, cam)
    strided = {n: getattr(g, n).T.contiguous().T if n != "rotation" else g.rotation for n in FIELDS}
    strided["opacity"] = torch.tensor(0.7).expand(12)
    leaves = {n: v.to(GPU_DEVICE).requires_grad_() for n, v in strided.items()}
    matrices = [
        torch.tensor(np.asarray(m), dtype=torch.float32, device=GPU_DEVICE, requires_grad=True)
        for m in (cam.intrinsics, cam.world_to_camera)
    ]
    out = draw(Gaussians(**leaves), Camera(*matrices, cam.width, cam.height))
    assert torch.equal(out.color, plain.color)
    out.color.sum().backward()
    for leaf in (*leaves.values(), *matrices):
        assert leaf.grad is not None
        assert (leaf.grad.shape, leaf.grad.dtype, leaf.grad.device) == (leaf.shape, leaf.dtype, leaf.device)


@needs_triton
@pytest.mark.usefixtures("quick")
def test_gaussians_that_were_changed_before_the_backward_pass_are_refused() -> None:
    """Gradients there would be of neither scene."""
    g = cloud(5, dtype=torch.float32)
    mean = g.mean.to(GPU_DEVICE).requires_grad_()
    out = draw(dataclasses.replace(g, mean=mean), camera())
    with torch.no_grad():
        mean += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        out.color.sum().backward()


@needs_triton
@pytest.mark.usefixtures("quick")
def test_cameras_that_have_no_gradient_and_gaussians_that_have_none() -> None:
    """Inference keeps nothing; a pose alone may be wanted; a backward pass may be run twice."""
    g, pose = cloud(10, dtype=torch.float32), torch.eye(4, requires_grad=True)
    assert not draw(g, camera()).alpha.requires_grad
    out = draw(g, Camera(camera().intrinsics, pose, 48, 40))
    first, second = (torch.autograd.grad(out.alpha.sum(), pose, retain_graph=True)[0] for _ in range(2))
    assert first.any()
    assert torch.equal(first, second)


@needs_triton
@pytest.mark.usefixtures("quick")
def test_a_picture_that_is_dropped_gives_back_its_memory_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not when Python's collector comes by: hundreds of MiB a picture would pile up on a device until then."""
    kept: list[weakref.ref[torch.Tensor]] = []

    def watched(*given: Any) -> backend.Drawn:
        made = real(*given)
        kept.append(weakref.ref(made.light))
        return made

    real = backend.draw
    monkeypatch.setattr(backend, "draw", watched)
    leaves = {n: getattr(cloud(5, dtype=torch.float32), n).requires_grad_() for n in FIELDS}
    gc.disable()
    try:
        out = draw(Gaussians(**leaves), camera())
        assert kept[0]() is not None  # its backward pass may come
        del out
        assert kept[0]() is None
    finally:
        gc.enable()


@needs_triton
@pytest.mark.usefixtures("quick")
def test_every_number_of_an_extreme_scene_is_finite() -> None:
    for seed in range(8):
        out, _ = drawn(*scene(seed))
        assert not bool((out.alpha > 1 + 1e-6).any())


@needs_triton
@pytest.mark.usefixtures("quick")
def test_a_gradient_beyond_float32_is_dropped_alone_and_said(caplog: pytest.LogCaptureFixture) -> None:
    """Two Gaussians far apart; the colour of one makes the gradient of its place overflow."""
    g = gaussians([[-0.4, 0, 2.0], [0.4, 0, 2.0]], 0.05, dtype=torch.float32)
    bright = dataclasses.replace(g, color=g.color * torch.tensor([[3e38], [1.0]]))
    leaves = {n: getattr(bright, n).clone().requires_grad_() for n in FIELDS}
    k = torch.as_tensor(camera().intrinsics).requires_grad_()
    with caplog.at_level(logging.WARNING):
        draw(Gaussians(**leaves), Camera(k, np.eye(4), 48, 40)).color.sum().backward()
    assert any("gradients of 1 Gaussians are beyond float32" in m for m in caplog.messages)
    gradients = [leaf.grad for leaf in leaves.values()]
    assert all(v is not None and torch.isfinite(v).all() and not v[0].any() for v in gradients)
    assert leaves["mean"].grad is not None
    assert leaves["mean"].grad[1].any()
    assert k.grad is not None
    assert torch.isfinite(k.grad).all()
    assert k.grad.any()


@needs_triton
@pytest.mark.usefixtures("quick")
def test_same_picture_as_gsplat() -> None:
    case = reference_case("tiny_case")
    out = draw(case.gaussians(torch.float32), case.camera, GSPLAT)
    assert np.abs(torch.cat([out.color, out.alpha[..., None]], dim=2).numpy() - case.picture).max() < 1e-5


def boxes_and_depths(number: int, across: int, down: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Boxes [N, 4] of tiles, a third of them empty, and depths [N] of which many are alike; int32."""
    rng = np.random.default_rng(0)
    low = rng.integers(0, [across, down], (number, 2))
    high = np.minimum(low + rng.integers(1, 5, (number, 2)), [across, down])
    boxes = np.concatenate([low, high], axis=1)
    boxes[::3] = 0
    depths = np.where(boxes[:, 2] > 0, rng.integers(1, 9, number), projection.LAST)
    return torch.as_tensor(boxes, dtype=torch.int32), torch.as_tensor(depths, dtype=torch.int32)


@needs_triton
@pytest.mark.parametrize(("width", "height", "number"), [(37, 29, 700), (2904, 816, 40), (37, 29, 1), (37, 29, 0)])
def test_lists_hold_every_intersection_once_by_tile_and_depth(width: int, height: int, number: int) -> None:
    """Of few tiles, of more than 16 bits number, and of nothing."""
    cam, tile = camera(width, height), 8
    across, down = -(-width // tile), -(-height // tile)
    boxes, depths = boxes_and_depths(number, across, down)
    reached = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    order = tiles.by_depth(depths.to(GPU_DEVICE), reached.to(GPU_DEVICE))
    lists = tiles.list_tiles(boxes.to(GPU_DEVICE), order, int(reached.sum()), cam, tile)
    ids, slots, starts, bases = (v.cpu() for v in (*lists, order.bases))
    nearest = np.lexsort([np.arange(number), depths])
    assert order.ids.tolist() == nearest.tolist()
    expected: list[list[int]] = [[] for _ in range(across * down)]
    for i in nearest:
        x0, y0, x1, y1 = boxes[i].tolist()
        for y, x in product(range(y0, y1), range(x0, x1)):
            expected[y * across + x].append(int(i))
    assert [ids[a:b].tolist() for a, b in pairwise(starts.tolist())] == expected
    assert sorted(slots.tolist()) == list(range(len(ids)))
    # slots of a Gaussian follow each other
    owners = torch.searchsorted(bases, slots.long(), right=True) - 1
    assert torch.equal(order.ids.cpu()[owners], ids.long())


@needs_triton
def test_s12_more_intersections_than_places_have_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "MOST_INTERSECTIONS", 100)
    boxes = torch.tensor([[0, 0, 6, 5]] * 60, dtype=torch.int32, device=GPU_DEVICE)
    order = tiles.by_depth(boxes[:, 2], 5 * boxes[:, 2])
    with pytest.raises(TooLarge, match="intersections"):
        tiles.list_tiles(boxes, order, 1800, camera(), 8)


@pytest.mark.parametrize(
    ("version", "says"),
    [
        (None, r"Triton is not installed: install the extra: pip install 'posegaussian\[gpu\]'"),
        ("3.1.0", r"Triton 3\.1\.0 is too old, 3\.2 is needed: install the extra: pip install 'posegaussian\[gpu\]'"),
        ("3.2.0", "the Gaussians are on cpu.*(choose 'cpu'|move them to 'cuda')"),
    ],
)
def test_what_is_lacking_is_said_with_what_to_do(
    version: str | None, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backend, "triton_version", lambda: version)
    monkeypatch.setattr(backend, "interpreted", lambda: False)
    with pytest.raises(ValueError, match=f"drawing.backend = 'gpu': {says}"):
        rasterize(cloud(3, dtype=torch.float32), [camera()], (), Drawing(backend="gpu"))


def test_triton_of_two_digits_is_not_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "triton_version", lambda: "3.10.1+git")
    assert backend.lacks(torch.device("cuda")) is None


@needs_triton
def test_what_it_cannot_draw_is_refused() -> None:
    g = to(cloud(3), torch.float32)
    there = Gaussians(*(getattr(g, n).to(GPU_DEVICE) for n in FIELDS))
    with pytest.raises(ValueError, match=r"'gpu' with torch\.float64 Gaussians: it draws float32"):
        rasterize(to(there, torch.float64), [camera()], (), Drawing(backend="gpu"))
    with pytest.raises(ValueError, match=r"alpha_max = 1\.0 with transmittance_stop = -1\.0"):
        rasterize(there, [camera()], (), Drawing(Cutoffs(alpha_max=1.0, transmittance_stop=-1.0), "gpu"))


class _OnCuda:
    """Gaussians as `resolve` asks about them, where there is no GPU."""

    def __init__(self, dtype: torch.dtype) -> None:
        self.mean = type("mean", (), {"device": torch.device("cuda"), "dtype": dtype})


def test_auto_chooses_by_device_and_says_why_it_is_slow(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    rasterizer._say_once.cache_clear()
    single, double = _OnCuda(torch.float32), _OnCuda(torch.float64)
    monkeypatch.setattr(backend, "triton_version", lambda: "3.2.0")
    assert [rasterizer.resolve("auto", g) for g in (single, double)] == ["gpu", "reference"]  # type: ignore[arg-type]
    assert rasterizer.resolve("auto", cloud(1, dtype=torch.float32)) == "cpu"
    monkeypatch.setattr(backend, "triton_version", lambda: None)
    with caplog.at_level(logging.WARNING):
        assert [rasterizer.resolve("auto", single) for _ in range(2)] == ["reference"] * 2  # type: ignore[arg-type]
    assert len(caplog.messages) == 1
    assert "Triton is not installed" in caplog.messages[0]


COMPILE = """
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from posegaussian.stages.splatting.gpu import backend, composite, projection, projection_backward, tiles
pictures = {"CHANNELS": 7, "TILE": backend.SHAPE.tile, "CHUNK": backend.SHAPE.chunk}
projected = {"TILE": backend.SHAPE.tile, "COMPENSATED": True, "BLOCK": projection.BLOCK}
back = {"CHANNELS": 7, "COMPENSATED": True, "CAMERA": True, "BLOCK": projection_backward.BLOCK}
own, usual = {"num_warps": backend.SHAPE.warps, "enable_fp_fusion": True}, {"enable_fp_fusion": False}
given = [
    (composite.composite, "*fp32 *i32 *i32 " + "*fp32 " * 3 + "*i32 fp32 fp32 fp32 i32 i32 i32",
     pictures | {"TRAINING": True}, own),
    (composite.composite_backward, "*fp32 *i32 *i32 *i32 *fp32 *i32 *fp32 *fp32 *fp32 fp32 fp32 i32 i32 i32",
     pictures, own),
    (projection.project, "*fp32 " * 7 + "*i32 *i32 *i32 *i64 i32", projected, usual),
    (projection_backward.project_backward, "*fp32 " * 5 + "*i64 *i64 " + "*fp32 " * 7 + "*i32 i32", back, usual),
    (tiles.spread, "*i64 *i64 *i32 *i16 *i32 i32 i32 i32 i32", {"BLOCK": tiles.BLOCK}, {}),
    (tiles.gather, "*i16 *i64 *i32 *i32 *i32 *i32 i32 i32 i32", {"BLOCK": tiles.BLOCK}, {}),
]
for kernel, kinds, fixed, options in given:
    signature = {**dict(zip(kernel.arg_names, kinds.split())), **dict.fromkeys(fixed, "constexpr")}
    made = triton.compile(ASTSource(kernel, signature, fixed), target=GPUTarget("cuda", 90, 32), options=options)
    assert len(made.asm["cubin"]) > 1000
    print(made.name, len(made.asm["cubin"]))
"""


@needs_triton
def test_kernels_compile_for_a_gpu_without_one() -> None:
    """The interpreter accepts what the compiler does not."""
    environment = {k: v for k, v in os.environ.items() if k != "TRITON_INTERPRET"}
    done = subprocess.run(
        [sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, done.stderr
