"""Splats as the rasterizer's Gaussians and back: rotations, harmonics, colours by direction, real scenes."""

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.stages.splatting.splat_scene import MOST_OPAQUE, quaternions, scene_of, sh_color, splats_of
from posegaussian.storage.formats.splat_ply import read_splats
from posegaussian.storage.model.splats import SH0, Splats
from tests.storage.formats.test_splat_files import made, real
from tests.support.gaussian_scenes import camera, cloud, draw
from tests.support.gsplat_reference import FOLDER, GSPLAT, harmonics, read_safetensors, reference_case


def test_a_rotation_matrix_turns_as_its_quaternion_does() -> None:
    """By the product of quaternions, whatever the quaternion's length."""
    rng = np.random.default_rng(0)
    q, v = rng.normal(size=(50, 4)), rng.normal(size=(50, 3))
    turned = np.einsum("nij,nj->ni", rotations(torch.from_numpy(3 * q)).numpy(), v)
    w, u = q[:, :1] / np.linalg.norm(q, axis=1, keepdims=True), q[:, 1:] / np.linalg.norm(q, axis=1, keepdims=True)
    expected = v + 2 * np.cross(u, np.cross(u, v) + w * v)
    np.testing.assert_allclose(turned, expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_quaternions_give_back_their_matrices(seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=(200, 4))
    # the half turns, where three of the four components are 0 or the trace is -1
    q[:8] = np.array(
        [
            [1, 0, 0, 0],
            [0, 1, 0, 0],
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [1e-9, 1, 0, 0],
            [0, 1, 1, 0],
            [0, -1, 0, 1],
            [1, 1, 1, 1],
        ]
    )
    r = rotations(torch.from_numpy(q)).numpy()
    found = quaternions(r)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-12)
    assert (found[:, 0] >= 0).all()
    np.testing.assert_allclose(rotations(torch.from_numpy(found)).numpy(), r, atol=1e-12)


def test_harmonics_are_those_of_the_reference_and_orthonormal() -> None:
    rng = np.random.default_rng(1)
    d = rng.normal(size=(40, 3))
    c = rng.normal(size=(40, 16, 3)) * 0.1
    expected = np.maximum(np.einsum("nk,nkc->nc", harmonics(d / np.linalg.norm(d, axis=1, keepdims=True)), c) + 0.5, 0)
    np.testing.assert_allclose(sh_color(torch.from_numpy(c), torch.from_numpy(d)).numpy(), expected, atol=1e-12)
    # Gauss-Legendre in z and 16 steps around integrate products of degree 6 exactly
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * np.pi / 8
    s = np.sqrt(1 - z**2)
    points = np.stack([np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(16))], axis=2).reshape(
        -1, 3
    )
    one = torch.eye(16, dtype=torch.float64)
    basis = (
        np.stack(
            [
                sh_color((0.4 * one[k])[None, :, None].expand(len(points), 16, 3), torch.from_numpy(points)).numpy()[
                    :, 0
                ]
                - 0.5
                for k in range(16)
            ],
            axis=1,
        )
        / 0.4
    )
    gram = np.einsum("n,nk,nl->kl", np.repeat(weight, 16) * np.pi / 8, basis, basis)
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-9)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_degrees_beyond_the_asked_do_not_count(degree: int) -> None:
    splats = made(30, 3)
    cut = Splats(
        splats.mean, splats.log_scale, splats.quaternion, splats.opacity_logit, splats.harmonics[:, : (degree + 1) ** 2]
    )
    torch.testing.assert_close(
        scene_of(splats).seen_from(camera(), degree).color, scene_of(cut).seen_from(camera()).color, rtol=0, atol=0
    )


def test_colours_are_never_negative_and_a_camera_inside_a_gaussian_sees_degree_zero() -> None:
    dark = torch.full((1, 4, 3), -9.0)
    assert (sh_color(dark, torch.ones(1, 3), 0) == 0).all()
    c = torch.full((1, 16, 3), 0.5)
    torch.testing.assert_close(sh_color(c, torch.zeros(1, 3)), torch.full((1, 3), 0.5 + 0.5 * SH0))
    with pytest.raises(ValueError, match="degree 4"):
        sh_color(c, torch.ones(1, 3), 4)


def test_what_is_not_finite_is_left_to_the_rasterizer() -> None:
    splats = made(4, 1)
    splats.mean[0] = np.nan
    splats.quaternion[1] = 0
    splats.log_scale[2] = np.inf
    splats.mean[3], splats.opacity_logit[3] = (0, 0, 3), 9
    out = draw(scene_of(splats).seen_from(camera()), camera())
    assert out.masked == 3
    assert torch.isfinite(out.color).all()
    assert out.alpha.max() > 0


def test_gaussians_written_as_splats_are_the_same_gaussians() -> None:
    g = cloud(300, dtype=torch.float32)
    g.opacity[0] = 1.0
    back = scene_of(splats_of(g)).seen_from(camera())
    torch.testing.assert_close(back.mean, g.mean, rtol=0, atol=0)
    # float32 of a logarithm of about -4, of a logit and of a coefficient up to 2: some units in the last place
    torch.testing.assert_close(back.scale, g.scale, rtol=1e-6, atol=0)
    torch.testing.assert_close(back.color, g.color, rtol=0, atol=3e-7)
    torch.testing.assert_close(back.opacity, g.opacity.clamp(max=MOST_OPAQUE), rtol=1e-6, atol=1e-6)
    # cloud() draws reflections, too; a covariance knows no handedness
    turned = torch.linalg.det(g.rotation) > 0
    assert turned.any()
    torch.testing.assert_close(back.rotation[turned], g.rotation[turned], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("mean", np.nan, "mean are not finite"),
        ("scale", 0.0, "scales above 0"),
        ("opacity", 1.5, "opacities in"),
        ("opacity", 0.0, "opacities in"),
    ],
)
def test_what_no_splat_can_hold_is_refused(field: str, value: float, words: str) -> None:
    g = cloud(5)
    getattr(g, field)[2] = value
    with pytest.raises(ValueError, match=words):
        splats_of(g)


def test_the_reference_scene_through_splats_is_the_reference_picture() -> None:
    """The whole way of a file: logarithms, logits, quaternions and harmonics of gsplat's own scene."""
    case = reference_case("basic_case")
    data = read_safetensors(FOLDER / "basic_case.safetensors")
    splats = Splats(*(data[k].copy() for k in ("means", "scales", "quats", "opacities", "coeffs")))
    out = draw(scene_of(splats).seen_from(case.camera), case.camera, GSPLAT)
    picture = torch.cat([out.color, out.alpha[..., None]], dim=2).numpy()
    assert np.abs(picture - case.picture).max() < 1e-5  # gsplat's float32 sums near 1 and ours


@pytest.mark.parametrize("name", ["fruit_drops_minimal.ply", "guitar.compressed.ply"])
def test_real_scenes_are_rendered(name: str) -> None:
    splats = read_splats(real(name)).splats
    low, high = np.percentile(splats.mean, [10, 90], axis=0)
    pose = np.eye(4)
    pose[:3, 3] = -(low + high) / 2 + [0, 0, np.linalg.norm(high - low)]
    target = Camera(np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), pose, 64, 64)
    out = draw(scene_of(splats).seen_from(target), target, Cutoffs(low_pass=0.3))
    assert out.masked == 0
    assert torch.isfinite(out.color).all()
    assert 0.5 < float(out.alpha.max()) <= 1
