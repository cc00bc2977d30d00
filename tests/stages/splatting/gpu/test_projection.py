"""The GPU's projection and its gradients against the reference and autograd, in Triton's interpreter without a GPU:
cameras that are turned and skewed, Gaussians beyond the limits of the ray, behind the camera and beyond float32."""

import dataclasses

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.definition.projection import project
from posegaussian.stages.splatting.definition.reference import sorted_by_depth
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from posegaussian.stages.splatting.gpu import backend
from tests.hard_cases.laws import FIELDS, drawn, relative, to
from tests.support import gaussian_scenes
from tests.support.gaussian_scenes import GPU_DEVICE, NO_GPU, cloud

if NO_GPU is None:
    from posegaussian.stages.splatting.gpu.projection import DEPTH, view_of
    from posegaussian.stages.splatting.gpu.tiles import by_depth

needs_triton = pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))


def slanted() -> Camera:
    """Turned and moved, skewed, and so wide that the Gaussians of `around` lie on both sides of every limit of the
    ray."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn * np.linalg.det(turn), [0.3, -0.2, 0.5]
    return Camera(np.array([[30.0, 4.0, 25.0], [0.0, 42.0, 18.0], [0.0, 0.0, 1.0]]), pose, 48, 40)


def around(n: int, cam: Camera) -> Gaussians:
    """A cloud before the camera, half of it moved far to the side or behind it, larger."""
    g, rng = cloud(n, seed=3, dtype=torch.float32), np.random.default_rng(1)
    moved = torch.as_tensor(rng.uniform(-1, 1, (n, 3)) * [6.0, 6.0, 4.0], dtype=torch.float32)
    moved[::2] = 0
    turn, place = torch.as_tensor(np.asarray(cam.world_to_camera), dtype=torch.float32).split([3, 1], dim=1)
    mean = (g.mean + moved - place[:3, 0]) @ turn[:3]
    scale = g.scale * (1 + moved.abs().amax(dim=1, keepdim=True))
    return dataclasses.replace(g, mean=mean, rotation=turn[:3].T @ g.rotation, scale=scale)


def reached_by_depth(found: backend.Projected) -> torch.Tensor:
    """[K] which Gaussians reach a tile, nearest first."""
    ids = by_depth(found.depths, found.reached).ids
    return ids[found.reached[ids] > 0].cpu()


@needs_triton
@pytest.mark.parametrize("cutoffs", [Cutoffs(), Cutoffs(low_pass=0.3), Cutoffs(low_pass=0.3, compensation=True)])
def test_the_projection_is_the_references(cutoffs: Cutoffs) -> None:
    """The same Gaussians in the same order, with the same depths to the bit and the same tiles; the rest but for
    rounding. Those whose projection is beyond float32 are masked where they would be seen, and only there."""
    cam = slanted()
    g = around(400, cam)
    vast = torch.zeros(400, dtype=torch.bool)
    vast[:160], dim = True, g.opacity.clone()
    dim[:3] = 0.001  # seen by nobody
    g = dataclasses.replace(g, scale=torch.where(vast[:, None], 1e30, g.scale), opacity=dim)
    projected = project(g, cam, cutoffs)
    kept = sorted_by_depth(projected, cam, 8)
    there = [getattr(g, n).to(GPU_DEVICE) for n in FIELDS]
    job = backend.GpuJob(cam, cutoffs, 7, backend.Shape())
    found = backend.project(there, view_of(cam, cutoffs, GPU_DEVICE), job)
    tiles_in_all, masked = found.tallies.tolist()
    ids = reached_by_depth(found)
    rows, boxes = found.rows.cpu()[ids], found.boxes.cpu()[ids].long()
    reached = (kept.boxes[:, 2] > kept.boxes[:, 0]) & (kept.boxes[:, 3] > kept.boxes[:, 1])
    assert 100 < masked == projected.masked < 157  # three are dim, some of the moved ones behind the camera
    assert 150 < len(ids) < 240  # none is culled of those that stay before the camera, nor all of the others
    assert torch.equal(ids, kept.ids[reached])
    assert torch.equal(rows[:, DEPTH], kept.features[reached, DEPTH])
    assert torch.equal(boxes, kept.boxes[reached])
    count = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    assert torch.equal(found.reached.cpu()[ids].long(), count)
    assert tiles_in_all == int(found.reached.sum()) == int(count.sum())
    torch.testing.assert_close(rows[:, :14], kept.features[reached], rtol=1e-5, atol=1e-5)


FEATURES = {3: 10, 4: 11, 7: 14}
"""Of a Gaussian's features those that so many channels draw."""


def slopes(rows: torch.Tensor, sums: torch.Tensor) -> torch.Tensor:
    """[K, F] what sums [K, 16] of slots are by the features [K, F]. With W the whitening, (p, q) = W d and m = alpha
    dL/dalpha: by the centre W^T (m p, m q), by W -(m p, m q) d^T = -[[m pp, m pq], [m pq, m qq]] W^-T, by the opacity
    m / opacity; the rest is as it was summed."""
    w = rows[:, 2:6].reshape(-1, 2, 2)
    mass, first, second = sums[:, 0], sums[:, 1:3, None], sums[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    centre = (w.mT @ first)[..., 0]
    whitening = -(second @ torch.linalg.inv(w).mT).reshape(-1, 4)
    return torch.cat([centre, whitening, (mass / rows[:, 6])[:, None], sums[:, 6 : rows.shape[1] - 1]], dim=1)


@needs_triton
@pytest.mark.parametrize("channels", [3, 4, 7])
@pytest.mark.parametrize("cutoffs", [Cutoffs(), Cutoffs(low_pass=0.3), Cutoffs(low_pass=0.3, compensation=True)])
def test_gradients_of_the_projection_are_those_of_autograd(cutoffs: Cutoffs, channels: int) -> None:
    """From sums of slots to attributes and camera, for more Gaussians than a program holds, beyond the limits of the
    ray too: against autograd of the reference in float64. Roundings are 1e-7, and the camera's sums over 200 Gaussians
    cancel. Without the camera's gradients the others have the same bits."""
    cam = slanted()
    g = around(400, cam)
    there = [getattr(g, n).to(GPU_DEVICE) for n in FIELDS]
    job = backend.GpuJob(cam, cutoffs, channels, backend.Shape())
    view = view_of(cam, cutoffs, GPU_DEVICE)
    projected = backend.project(there, view, job)
    order, ids = by_depth(projected.depths, projected.reached), reached_by_depth(projected)
    given = torch.as_tensor(np.random.default_rng(0).normal(size=(len(g.mean), 16)), dtype=torch.float32)
    found, camera_found = backend.project_backward(there, view, order, given.to(GPU_DEVICE), job, True)
    alone, none = backend.project_backward(there, view, order, given.to(GPU_DEVICE), job, False)
    assert none is None
    assert all(torch.equal(a, b) for a, b in zip(found, alone, strict=True))
    leaves = {n: getattr(g, n).double().requires_grad_() for n in FIELDS}
    matrices = [torch.tensor(np.asarray(m), requires_grad=True) for m in (cam.intrinsics, cam.world_to_camera)]
    kept = sorted_by_depth(project(Gaussians(**leaves), Camera(*matrices, cam.width, cam.height), cutoffs), cam, 8)
    places = {int(n): k for k, n in enumerate(kept.ids)}
    rows = kept.features[[places[int(n)] for n in ids], : FEATURES[channels]]
    rows.backward(slopes(rows.detach(), given[: len(ids)].double()))
    for name, value in zip(FIELDS, found, strict=True):
        assert relative(value.cpu(), leaves[name].grad) < 1e-5, name
    assert camera_found is not None
    for value, leaf in zip(backend.camera_gradients(camera_found, *matrices), matrices, strict=True):
        assert relative(value, leaf.grad) < 1e-5


@needs_triton
def test_gradients_of_a_slanted_camera_and_of_gaussians_beyond_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole way, against the reference in float64. Thresholds flip between the precisions for few contributions
    of 1/255: 1e-4, where a wrong term changes the first digit."""
    monkeypatch.setattr(gaussian_scenes, "compiled", "gpu")
    if backend.interpreted():
        monkeypatch.setattr(backend, "SHAPE", backend.Shape(tile=64, chunk=32))  # few programs
    cam, cutoffs = slanted(), Cutoffs(low_pass=0.3, compensation=True)
    g = around(60, cam)
    (_, found), (_, expected) = drawn(g, cam, cutoffs), drawn(to(g, torch.float64), cam, cutoffs)
    for name, value in expected.items():
        assert relative(found[name], value) < 1e-4, name
