"""The interface: threads, cameras in one call, and what is refused."""

import dataclasses

import numpy as np
import pytest
import torch

from stages.rendering.rasterizer import Drawing, rasterize
from stages.rendering.scene import Camera
from tests.hard_cases.laws import drawn, pictures, relative, to
from tests.stages.rendering.scenes import camera, cloud, turned_about_y


def test_bits_do_not_depend_on_threads_or_on_the_run() -> None:
    g = cloud(20_000, dtype=torch.float32)
    g, cam = dataclasses.replace(g, scale=g.scale * 0.1), camera(200, 150, 200.0)
    one, gradients = drawn(g, cam)
    for threads in (1, 2, 3):
        out, others = drawn(g, cam, threads=threads)
        assert all(torch.equal(a, b) for a, b in zip(pictures(one), pictures(out), strict=True))
        assert all(torch.equal(gradients[n], others[n]) for n in gradients)


def test_cameras_are_drawn_as_if_alone_and_share_gradients() -> None:
    g = cloud(50, dtype=torch.float32)
    turned = np.eye(4)
    turned[:3, :3] = turned_about_y(10)
    cams = [camera(), Camera(camera().intrinsics, turned, 48, 40)]
    opacity = g.opacity.clone().requires_grad_()
    together = rasterize(dataclasses.replace(g, opacity=opacity), cams, ("depth", "normal"))
    together.color.sum().backward()
    shared, opacity.grad = opacity.grad, None
    for i, cam in enumerate(cams):
        alone = rasterize(dataclasses.replace(g, opacity=opacity), [cam], ("depth", "normal"))
        assert all(torch.equal(a[0], b[i]) for a, b in zip(pictures(alone), pictures(together), strict=True))
        alone.color.sum().backward()
    assert shared is not None
    assert opacity.grad is not None
    assert relative(shared, opacity.grad) < 1e-6


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cameras": []}, "cameras = "),
        ({"cameras": camera()}, "list of one or more"),
        ({"cameras": [camera(), camera(9, 9)]}, "call once a size"),
        ({"extras": ("normals",)}, "'normals'.*depth, normal"),
        ({"drawing": Drawing(backend="gpu2")}, "'gpu2'.*choose from"),  # type: ignore[arg-type]
        ({"drawing": Drawing(threads=0)}, "threads = 0"),
        ({"gaussians": cloud(3), "drawing": Drawing(backend="cpu")}, "float64.*convert"),
        ({"gaussians": dataclasses.replace(cloud(3), scale=torch.ones(3, 2))}, r"scale has shape \(3, 2\)"),
        ({"gaussians": dataclasses.replace(cloud(3), color=torch.ones(3, 3))}, "color is torch.float32"),
        ({"gaussians": to(cloud(3), torch.float16)}, "float16"),
        ({"cameras": [camera(40_000, 2)]}, "width = 40000"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_argument_its_value_and_what_to_do(change: dict[str, object], says: str) -> None:
    given = {"gaussians": cloud(3, dtype=torch.float32), "cameras": [camera()], "extras": (), "drawing": None} | change
    with pytest.raises(ValueError, match=says):
        rasterize(**given)  # type: ignore[arg-type]
