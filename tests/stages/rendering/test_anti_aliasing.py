"""The mip filter: coarse pictures come near the average of the full one,
and a picture as fine as its sources is left alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.run import prior
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.mip import mip_filter
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize

SIZE = 128


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=SIZE, frames=1, held_out=1)


@pytest.fixture(scope="module")
def gaussians(person: PersonCapture) -> Gaussians:
    """Of the two views beside the held-out one, from true depth, as they face it."""
    target, parts = camera(person, 1), []
    for v in (0, 1):
        scale, normal, opacity = prior(
            person.depth[0, v],
            (person.depth[0, v] > 0).astype(np.float32),
            person.mask[0, v],
            person.rig.intrinsics[v],
            GaussiansParams(),
        )
        maps = GaussianMaps(person.color[0, v], person.depth[0, v], scale, normal, opacity)
        parts.append(
            lift(
                maps, person.rig.intrinsics[v], person.rig.world_to_camera[v], torch.float32, torch.device("cpu")
            ).seen_from(target)
        )
    return Gaussians.concatenate(parts)


def camera(person: PersonCapture, coarser: int) -> Camera:
    held_out = person.views.held_out[0]
    return Camera(
        np.diag([1 / coarser, 1 / coarser, 1]) @ person.rig.intrinsics[held_out],
        person.rig.world_to_camera[held_out],
        SIZE // coarser,
        SIZE // coarser,
    )


def cutoffs(person: PersonCapture, coarser: int) -> Cutoffs:
    return mip_filter(
        camera(person, coarser), person.rig, [0, 1], look_at_point(person.rig.subset(person.views.sources))
    )


def drawn(gaussians: Gaussians, at: Camera, how: Cutoffs) -> np.ndarray:
    """[h, w, 4] colour and alpha."""
    picture = rasterize(gaussians, [at], drawing=Drawing(how))
    return torch.cat([picture.color[0], picture.alpha[0, ..., None]], dim=2).numpy()


@pytest.mark.parametrize("coarser", [2, 4])
def test_a_coarse_picture_is_the_average_of_the_full_one(
    person: PersonCapture, gaussians: Gaussians, coarser: int
) -> None:
    full = drawn(gaussians, camera(person, 1), Cutoffs())
    wanted = full.reshape(SIZE // coarser, coarser, SIZE // coarser, coarser, 4).mean(axis=(1, 3))
    mip = cutoffs(person, coarser)
    near, plain, fat = (
        psnr(drawn(gaussians, camera(person, coarser), how), wanted, 1.0, 100.0)
        for how in (mip, Cutoffs(), replace(mip, compensation=False))
    )
    # At 256 px and over the person alone: 34.4, 28.8 and 23.7 dB at a half, 30.8, 24.6 and 17.8 at a quarter.
    assert near > plain + 4
    assert near > fat + 9


def test_a_picture_as_fine_as_its_sources_is_drawn_as_ever(person: PersonCapture) -> None:
    k, pose = person.rig.intrinsics[0], person.rig.world_to_camera[0]
    subject = look_at_point(person.rig)
    assert mip_filter(Camera(k, pose, SIZE, SIZE), person.rig, [0, 1], subject).low_pass == pytest.approx(0.0, abs=1e-9)
    assert mip_filter(Camera(np.diag([4.0, 4.0, 1.0]) @ k, pose, 192, 192), person.rig, [0, 1], subject) == Cutoffs()
    half = mip_filter(Camera(np.diag([0.5, 0.5, 1.0]) @ k, pose, 48, 48), person.rig, [0, 1], subject)
    assert half == Cutoffs(low_pass=pytest.approx(0.75 / 12), compensation=True)  # type: ignore[arg-type]
