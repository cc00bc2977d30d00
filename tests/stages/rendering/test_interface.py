"""The interface: threads, cameras in one call, and what is refused."""

import dataclasses

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing
from posegaussian.stages.splatting.rasterizer import rasterize
from tests.hard_cases.laws import drawn, pictures, relative, to
from tests.support.gaussian_scenes import camera, cloud, turned_about_y


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


def changed(name: str, row: int, column: int, value: float) -> Camera:
    """A camera with one entry of a matrix replaced."""
    matrix = np.array(getattr(camera(), name))
    matrix[row, column] = value
    return dataclasses.replace(camera(), **{name: matrix})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cameras": []}, r"cameras = \[\].*list of one or more"),
        ({"cameras": camera()}, "cameras = one of 48 x 40 px.*list of one or more"),
        ({"cameras": ["front"]}, "cameras = .'front'.*list of one or more"),
        ({"cameras": [camera(), camera(9, 9)]}, "2 sizes.*call once a size"),
        ({"cameras": [camera(0, 9)]}, "camera.width = 0 px.*at least 1"),
        ({"cameras": [dataclasses.replace(camera(), height=40.0)]}, "camera.height = 40.0 px.*round"),
        ({"cameras": [camera(40_000, 2)]}, "camera.width = 40000.*render in parts"),
        (
            {"cameras": [dataclasses.replace(camera(), intrinsics=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])]},
            r"camera.intrinsics = \[\[1.*array or tensor",
        ),
        (
            {"cameras": [dataclasses.replace(camera(), world_to_camera=np.eye(4)[:3])]},
            r"camera.world_to_camera has shape \(3, 4\).*shape \(4, 4\)",
        ),
        ({"cameras": [changed("intrinsics", 0, 0, 0.0)]}, "camera.intrinsics = .*positive focal"),
        ({"cameras": [changed("intrinsics", 1, 0, 3.0)]}, "camera.intrinsics = .*0 below"),
        ({"cameras": [changed("intrinsics", 2, 0, 24.0)]}, r"camera.intrinsics has the last row \[24.*transposed"),
        (
            {"cameras": [changed("world_to_camera", 3, 0, 1.5)]},
            r"camera.world_to_camera has the last row \[1.5.*transposed",
        ),
        ({"cameras": [changed("world_to_camera", 0, 3, np.nan)]}, "camera.world_to_camera holds.*nan.*mend"),
        ({"extras": ("normals",)}, "extras = .'normals'.*'depth', 'normal'"),
        ({"extras": "depth"}, "extras = 'depth': pass a tuple"),
        ({"drawing": Cutoffs()}, "drawing = Cutoffs.*pass Drawing"),
        ({"drawing": Drawing(backend="gpu2")}, "drawing.backend = 'gpu2'.*choose from"),  # type: ignore[arg-type]
        ({"drawing": Drawing(threads=0)}, "drawing.threads = 0.*at least 1"),
        ({"drawing": Drawing(threads=1.5)}, "drawing.threads = 1.5.*whole number"),  # type: ignore[arg-type]
        *(
            ({"drawing": Drawing(Cutoffs(**{n: v}))}, rf"drawing.cutoffs.{n} = {v}.*choose")
            for n, v in (
                ("near", -1.0),
                ("near", np.nan),
                ("low_pass", -0.3),
                ("frustum_margin", -0.1),
                ("variance_min", -1e-3),
                ("compensation_min", 2.0),
                ("alpha_max", 1.5),
                ("alpha_min", 0.0),
                ("alpha_min", 0.995),
                ("transmittance_stop", 1.5),
            )
        ),
        ({"gaussians": None}, "gaussians.mean is a NoneType.*tensors"),
        (
            {"gaussians": dataclasses.replace(cloud(3), opacity=np.ones(3))},
            "gaussians.opacity is a ndarray.*torch.as_tensor",
        ),
        (
            {"gaussians": cloud(3), "drawing": Drawing(backend="cpu")},
            "drawing.backend = 'cpu' with torch.float64.*convert",
        ),
        (
            {"gaussians": dataclasses.replace(cloud(3), scale=torch.ones(3, 2))},
            r"gaussians.scale has shape \(3, 2\).*reshape",
        ),
        (
            {"gaussians": dataclasses.replace(cloud(3), mean=torch.tensor(1.0))},
            r"gaussians.mean has shape \(\).*reshape",
        ),
        (
            {"gaussians": dataclasses.replace(cloud(3), color=torch.ones(3, 3))},
            "gaussians.color is torch.float32.*convert",
        ),
        ({"gaussians": to(cloud(3), torch.float16)}, "gaussians.mean is torch.float16.*convert"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_argument_its_value_and_what_to_do(
    change: dict[str, object], says: str
) -> None:
    given = {"gaussians": cloud(3, dtype=torch.float32), "cameras": [camera()], "extras": (), "drawing": None} | change
    with pytest.raises(ValueError, match=says):
        rasterize(**given)  # type: ignore[arg-type]
