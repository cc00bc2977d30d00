"""Laws of the fusion of image and pose features, the same for all seven kinds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import get_args

import pytest
import torch
from torch import nn

from posegaussian.stages.network.model.fusion import FUSIONS, Fusion, ImageOnly, depth_fusion
from posegaussian.stages.network.model.presets import PRESETS, FusionKind

IMAGE, POSE = 16, 5
KINDS = pytest.mark.parametrize("kind", list(FUSIONS))


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    torch.manual_seed(3)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def _given(batch: int = 2, height: int = 5, width: int = 7) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.randn(batch, IMAGE, height, width), torch.rand(batch, POSE, height, width)


def _fusion(kind: FusionKind) -> Fusion:
    fusion = FUSIONS[kind](IMAGE, POSE)
    if kind == "weighted":
        nn.init.normal_(fusion.weight)
    return fusion


def test_every_kind_that_can_be_chosen_exists() -> None:
    assert set(FUSIONS) == set(get_args(FusionKind))


@pytest.mark.parametrize(
    ("kind", "thousands"),
    [
        ("concatenation", 167),
        ("attention", 179),
        ("gated", 317),
        ("addition", 150),
        ("multiplication", 150),
        ("weighted", 150),
        ("outer", 817),
    ],
)
def test_parameters_of_128_channels_and_17_joints(kind: FusionKind, thousands: int) -> None:
    assert round(sum(p.numel() for p in FUSIONS[kind](128, 17).parameters()) / 1000) == thousands


@KINDS
def test_the_shape_is_that_of_the_image_features(kind: FusionKind) -> None:
    for size in ((1, 1), (5, 7)):
        image, pose = _given(2, *size)
        assert _fusion(kind)(image, pose).shape == image.shape


@KINDS
@pytest.mark.parametrize("pose", [(2, POSE, 1, 1), (1, POSE, 5, 7), (2, POSE + 1, 5, 7), (POSE, 5, 7)], ids=str)
def test_shapes_that_differ_are_refused_and_never_broadcast(kind: FusionKind, pose: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"image \(2, 16, 5, 7\) and pose"):
        _fusion(kind)(torch.zeros(2, IMAGE, 5, 7), torch.zeros(pose))


@KINDS
def test_both_inputs_matter_everywhere_and_gradients_reach_every_parameter(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = (x.requires_grad_() for x in _given())
    out = fusion(image, pose)
    (out * torch.randn_like(out)).sum().backward()
    for gradient in (image.grad, pose.grad):
        # Every channel of every cell has its say.
        assert torch.isfinite(gradient).all()
        assert gradient.ne(0).all()
    dead = [
        n
        for n, p in fusion.named_parameters()
        if p.grad is None or not torch.isfinite(p.grad).all() or not p.grad.any()
    ]
    assert not dead


@KINDS
def test_neither_input_can_be_exchanged(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = _given()
    with torch.no_grad():
        out = fusion(image, pose)
        for other in (fusion(image.flip(3), pose), fusion(image, pose.flip(3)), fusion(image, pose.flip(1))):
            assert (other - out).abs().mean() > 1e-3


@KINDS
def test_batch_neighbours_do_not_matter(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = _given()
    others = [x.clone() for x in (image, pose)]
    for x in others:
        x[1] = 9 * torch.randn_like(x[1])
    with torch.no_grad():
        assert torch.equal(fusion(image, pose)[0], fusion(*others)[0])


@KINDS
def test_threads_change_no_byte(kind: FusionKind) -> None:
    # At the widths of a real network: torch's convolutions round otherwise with more threads to a handful of channels.
    fusion = FUSIONS[kind](128, 17)
    for layout in (torch.contiguous_format, torch.channels_last):
        image, pose = (x.to(memory_format=layout) for x in (torch.randn(2, 128, 32, 32), torch.rand(2, 17, 32, 32)))
        found = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.no_grad():
                found.append(fusion(image, pose))
        assert torch.equal(*found)


@KINDS
def test_bf16_stays_near_float32(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = _given()
    with torch.no_grad():
        exact = fusion(image, pose)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = fusion(image, pose)
            mixed = fusion(image.bfloat16(), pose)
    for found in (rounded, mixed):
        # bf16 has 8 bits, 0.4 % a rounding; at most five in a row here.
        assert (found.float() - exact).pow(2).mean().sqrt() < 0.01 * exact.pow(2).mean().sqrt()


@KINDS
def test_a_pose_of_zeros_leaves_the_picture(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = _given()
    none = torch.zeros_like(pose).requires_grad_()
    out = fusion(image, none)
    out.sum().backward()
    assert torch.isfinite(out).all()
    assert torch.isfinite(none.grad).all()
    with torch.no_grad():
        # Pictures that differ still give features that differ, by as much as with a pose to a factor of a few.
        without, with_pose = ((fusion(image.flip(0), p) - fusion(image, p)).pow(2).mean().sqrt() for p in (none, pose))
    assert without > 0.3 * with_pose


@pytest.mark.parametrize("kind", ["addition", "multiplication"])
def test_a_pose_of_zeros_is_the_picture_alone(kind: FusionKind) -> None:
    fusion = _fusion(kind)
    image, pose = _given()
    with torch.no_grad():
        assert torch.equal(fusion(image, torch.zeros_like(pose)), fusion.out(image))


def test_a_gate_at_its_ends_takes_one_input() -> None:
    fusion = _fusion("gated")
    image, pose = _given()
    with torch.no_grad():
        fusion.gate.weight.zero_()
        for bias, want in ((50.0, image), (-50.0, fusion.project(pose))):
            fusion.gate.bias.fill_(bias)
            # sigma(-50) is 2e-22, nothing beside float32's epsilon.
            torch.testing.assert_close(fusion(image, pose), fusion.out(want))


def test_an_outer_product_is_linear_in_both_inputs_at_once() -> None:
    """The mixed second difference of a bilinear map is the product itself: equal however large the steps."""
    fusion = _fusion("outer").double()
    (f, p), (df, dp) = ([x.double() for x in _given()] for _ in range(2))

    def mixed(s: float, t: float) -> torch.Tensor:
        return (fusion(f + s * df, p + t * dp) - fusion(f + s * df, p) - fusion(f, p + t * dp) + fusion(f, p)) / (s * t)

    with torch.no_grad():
        assert mixed(1, 1).abs().mean() > 1e-3
        # Rounding of float64, times the steps' inverse.
        torch.testing.assert_close(mixed(1, 1), mixed(2, 0.5), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", list(FUSIONS))
def test_pose_is_read_only_where_the_preset_places_it(kind: FusionKind) -> None:
    image, pose = torch.randn(1, 64, 4, 4), torch.rand(1, 17, 4, 4)
    for places in (frozenset(), frozenset({"depth"}), frozenset({"decoder"}), frozenset({"depth", "decoder"})):
        fusion = depth_fusion(replace(PRESETS["fast"], fusion=kind, pose_in=places))
        with torch.no_grad():
            reads = not torch.equal(fusion(image, pose), fusion(image, torch.zeros_like(pose)))
        assert reads == ("depth" in places)
        assert isinstance(fusion, ImageOnly) != reads
