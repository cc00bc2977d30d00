"""Laws of the encoders: shapes, cost, gradients, and what a result may not depend on.
Pictures are a few cells large."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from posegaussian.stages.network.model.encoders import (
    Encoder,
    SqueezeExcitation,
    depth_encoder,
    heatmaps_on,
    image_encoder,
    pose_encoder,
)
from posegaussian.stages.network.model.fusion import depth_fusion
from posegaussian.stages.network.model.presets import COSTS, PRESETS, Preset

TINY = Preset("tiny", widths=(8, 8, 16, 16))
VARIANTS = [
    replace(TINY, stem_stride=stem, stages=stages, normalisation=norm, residual=residual, downsampling=down)
    for stem, stages, (norm, residual, down) in itertools.product(
        (1, 2),
        (3, 4),
        (("group", True, "stride"), ("batch", False, "pool"), ("group", False, "stride"), ("batch", True, "pool")),
    )
]
JOINTS = 17


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    torch.manual_seed(7)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def _name(preset: Preset) -> str:
    blocks = "residual" if preset.residual else "plain"
    return f"stem{preset.stem_stride}-k{preset.stages}-{preset.normalisation}-{blocks}-{preset.downsampling}"


def _stirred(module: torch.nn.Module) -> torch.nn.Module:
    """With norms and biases that are not 1 and 0, as after training."""
    with torch.no_grad():
        for p in module.parameters():
            if p.ndim == 1:
                p.add_(0.3 * torch.randn_like(p))
    return module


@pytest.mark.parametrize("preset", VARIANTS, ids=_name)
@pytest.mark.parametrize("cells", [(1, 2), (3, 1)])
def test_every_level_has_the_shape_it_declares(preset: Preset, cells: tuple[int, int]) -> None:
    encoder = image_encoder(preset)
    height, width = (c * preset.stride for c in cells)
    levels = encoder(torch.randn(2, 3, height, width))
    assert [tuple(x.shape) for x in levels] == [
        (2, c, height // s, width // s) for c, s in zip(encoder.channels, encoder.strides, strict=True)
    ]
    assert encoder.strides == tuple(2**i for i in range(preset.stem_stride - 1, preset.stages + 1))
    assert encoder.channels[-1] == preset.widths[-1]
    assert all(torch.isfinite(x).all() for x in levels)


@pytest.mark.parametrize("size", [(20, 16), (16, 20), (4, 16), (0, 16)])
def test_sizes_that_do_not_divide_are_refused(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=f"{size[0]} x {size[1]} px .* cells of 8 px; pad"):
        image_encoder(TINY)(torch.zeros(1, 3, *size))


@pytest.mark.parametrize("shape", [(1, 4, 16, 16), (3, 16, 16)])
def test_other_channels_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="encoder of 3 channels"):
        image_encoder(TINY)(torch.zeros(shape))


@pytest.mark.parametrize("preset", VARIANTS, ids=_name)
def test_gradients_reach_every_parameter(preset: Preset) -> None:
    encoder = _stirred(image_encoder(preset))
    # At least two cells a channel, or a batch norm has nothing to divide by.
    sum(
        (x * torch.randn_like(x)).sum() for x in encoder(torch.randn(2, 3, 2 * preset.stride, 2 * preset.stride))
    ).backward()
    dead = [
        n
        for n, p in encoder.named_parameters()
        if p.grad is None or not torch.isfinite(p.grad).all() or not p.grad.any()
    ]
    assert not dead


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("bf16", [False, True])
def test_threads_change_no_byte(layout: torch.memory_format, bf16: bool) -> None:
    encoder = _stirred(image_encoder(PRESETS["fast"])).eval().to(memory_format=layout)
    picture = torch.randn(2, 3, 32, 64).to(memory_format=layout)
    found = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            found.append(encoder(picture))
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


@pytest.mark.parametrize("preset", VARIANTS, ids=_name)
def test_batch_neighbours_do_not_matter(preset: Preset) -> None:
    # In evaluation: a batch norm that is learning sees its neighbours by design.
    encoder = _stirred(image_encoder(preset)).eval()
    pictures = torch.randn(2, 3, 2 * preset.stride, 2 * preset.stride)
    others = pictures.clone()
    others[1] = 9 * torch.randn_like(others[1])
    with torch.no_grad():
        assert all(
            torch.equal(a[0], b[0]) and not torch.equal(a[1], b[1])
            for a, b in zip(encoder(pictures), encoder(others), strict=True)
        )


def test_group_norm_in_training_sees_no_neighbours() -> None:
    encoder = image_encoder(TINY).train()
    pictures = torch.randn(2, 3, 16, 16)
    others = torch.stack([pictures[0], torch.zeros(3, 16, 16)])
    assert torch.equal(encoder(pictures)[-1][0], encoder(others)[-1][0])


@pytest.mark.parametrize("name", list(PRESETS))
def test_bf16_stays_near_float32(name: str) -> None:
    encoder = image_encoder(PRESETS[name]).eval()
    picture = torch.rand(1, 3, 32, 32) * 2 - 1
    with torch.no_grad():
        exact = encoder(picture)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = encoder(picture)
    for a, b in zip(exact, rounded, strict=True):
        # bf16 has 8 bits: 0.4 % a rounding, and some 20 in a row that add as a random walk.
        assert (a - b.float()).pow(2).mean().sqrt() < 0.02 * a.pow(2).mean().sqrt()


@pytest.mark.parametrize("encoder", [pose_encoder(TINY, JOINTS), depth_encoder(TINY)], ids=["pose", "depth"])
@pytest.mark.parametrize("stirred", [False, True])
def test_an_input_of_zeros_gives_finite_features_and_gradients(encoder: Encoder, stirred: bool) -> None:
    # The variance of a norm is 0 there, and its gradient is divided by the root of epsilon at every layer.
    encoder = _stirred(encoder) if stirred else encoder
    nothing = torch.zeros(1, encoder.inputs, 32, 32, requires_grad=True)
    levels = encoder(nothing)
    sum(x.sum() for x in levels).backward()
    assert all(torch.isfinite(x).all() for x in levels)
    assert torch.isfinite(nothing.grad).all()
    assert all(torch.isfinite(p.grad).all() for p in encoder.parameters())


def test_squeeze_and_excitation_is_one_number_a_channel() -> None:
    x = torch.rand(2, 8, 3, 5) + 1
    ratio = SqueezeExcitation(8)(x) / x
    # One multiplication and one division in float32.
    torch.testing.assert_close(ratio, ratio[:, :, :1, :1].expand_as(ratio), rtol=3e-7, atol=0)
    assert ((ratio > 0) & (ratio < 1)).all()


@pytest.mark.parametrize(("downsampling", "stem"), [("stride", 1), ("stride", 2), ("pool", 2)])
def test_features_lie_where_the_lag_says(downsampling: str, stem: int) -> None:
    """The middle of the pixels that a cell answers to, over all channels of several untrained encoders; their
    kernels' own leaning is left, under a px."""
    middles = []
    for seed in range(6):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            encoder = image_encoder(replace(TINY, downsampling=downsampling, stem_stride=stem))
        picture = torch.rand(1, 3, 96, 96, generator=torch.Generator().manual_seed(seed)).requires_grad_()
        cell = encoder(picture)[-1][0, :, 6, 6]
        weight = sum(torch.autograd.grad(c, picture, retain_graph=True)[0][0].square().sum(0) for c in cell)
        places = torch.arange(96) + 0.5
        middles += [float((weight.sum(axis) * places).sum() / weight.sum()) for axis in (0, 1)]
    assert np.mean(middles) == pytest.approx(6.5 * 8 - encoder.lag, abs=1.0)
    assert encoder.lag == (3.5 if downsampling == "stride" else 0.0)


def test_heatmaps_keep_their_mass_and_their_place() -> None:
    heatmaps = torch.rand(1, 2, 8, 12)
    assert torch.equal(heatmaps_on(heatmaps, 4), heatmaps)
    torch.testing.assert_close(heatmaps_on(heatmaps, 8).sum() * 4, heatmaps.sum())
    ramp = (torch.arange(12.0) + 0.5).expand(1, 1, 8, 12)
    for cell in (1, 2, 8):
        places = (torch.arange(48 // cell) + 0.5) * cell / 4
        # Bilinear interpolation is constant half a coarse cell from the rim.
        torch.testing.assert_close(heatmaps_on(ramp, cell)[0, 0, 0], places.clamp(0.5, 11.5))


@pytest.mark.parametrize(("cell", "said"), [(6, "power of 2"), (0, "power of 2"), (16, "multiples of 4")])
def test_heatmaps_on_cells_they_do_not_fill_are_refused(cell: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        heatmaps_on(torch.zeros(1, 2, 6, 8), cell)


@pytest.mark.parametrize(
    ("name", "parameters", "gflop"), [("paper", 2.44e6, 61.1), ("base", 2.44e6, 17.1), ("fast", 0.619e6, 4.34)]
)
def test_three_encoders_and_the_fusion_cost_their_share_of_the_network(
    name: str, parameters: float, gflop: float
) -> None:
    # To half a per cent, which is the rounding of these figures; 256 px, both directions.
    preset = PRESETS[name]
    with torch.device("meta"):
        encoders = image_encoder(preset), pose_encoder(preset), depth_encoder(preset)
        fusion = depth_fusion(preset)
        found = {}
        for side in (256, 512):
            cells = side // preset.stride
            with FlopCounterMode(display=False) as counter:
                for encoder, cell in zip(encoders, (1, preset.pose_cell, 1), strict=True):
                    encoder(torch.empty(2, encoder.inputs, side // cell, side // cell))
                fusion(torch.empty(2, preset.widths[-1], cells, cells), torch.empty(2, JOINTS, cells, cells))
            found[side] = counter.get_total_flops() / 1e9
    counted = sum(p.numel() for module in (*encoders, fusion) for p in module.parameters())
    assert counted == pytest.approx(parameters, rel=5e-3)
    assert found[256] == pytest.approx(gflop, rel=5e-3)
    # Convolutions cost by the area; the whole network's figures are rounded to a unit of at least 22.
    assert found[512] / found[256] == pytest.approx(COSTS[name].gflop[512] / COSTS[name].gflop[256], rel=0.03)
    # What is left is the recurrent update's and the decoder's:
    # more than a third, less than two thirds of the numbers learnt.
    assert 1 / 3 < 1 - counted / COSTS[name].parameters < 2 / 3


@pytest.mark.parametrize(
    "wrong",
    [
        {"stages": 5},
        {"stem_stride": 4},
        {"widths": (8, 8, 12, 16)},
        {"widths": (8, 8, 16)},
        {"hidden": 0},
        {"fusion": "sum"},
        {"normalisation": "layer"},
        {"pose_in": frozenset({"head"})},
        {"rotation_head": "euler"},
    ],
    ids=str,
)
def test_presets_that_cannot_be_built_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match="preset tiny: "):
        replace(TINY, **wrong)
