"""Laws of the heads: the prior at 0, bounds, gradients everywhere, and blends that never vanish."""

import pytest
import torch

from posegaussian.stages.geometry.tangent_frame import tangents
from posegaussian.stages.network.model.decoder import Decoder
from posegaussian.stages.network.model.heads import (
    FACING,
    HeadMaps,
    Heads,
    Prior,
    blend,
    blend_directions,
    blend_quaternions,
    growth,
    learned_normal,
    learned_opacity,
    learned_quaternion,
    learned_scale,
    limited,
    moved,
    normal_of,
    quaternion_of,
    seen_opacity,
)
from posegaussian.stages.splatting.quaternions import rotations

torch.set_num_threads(1)
FAR = torch.tensor([-1e4, -50.0, -6.0, -0.5, 0.0, 0.5, 6.0, 50.0, 1e4])


def facing(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Unit normals [1, 3, 1, n] that face the camera along unit rays [1, 3, 1, n], float64."""
    g = torch.Generator().manual_seed(seed)
    rays = torch.nn.functional.normalize(
        torch.randn(1, 3, 1, count, generator=g, dtype=torch.float64) * 0.3
        + torch.tensor([0, 0, 1.0])[None, :, None, None],
        dim=1,
    )
    n = torch.nn.functional.normalize(torch.randn(1, 3, 1, count, generator=g, dtype=torch.float64), dim=1)
    return torch.where((n * rays).sum(dim=1, keepdim=True) > 0, -n, n), rays


def prior(h: int = 4, w: int = 6, dtype: torch.dtype = torch.float32) -> tuple[Prior, torch.Tensor]:
    """A prior with holes in its first column, and rays."""
    n, rays = (v.reshape(1, 3, h, w).to(dtype) for v in facing(h * w))
    there = torch.ones(1, 1, h, w, dtype=dtype)
    there[..., 0] = 0
    g = torch.Generator().manual_seed(1)
    face_on = (0.1 + 0.8 * torch.rand(1, 1, h, w, generator=g, dtype=dtype)) * there
    return (
        Prior(8 * there, 0.002 * there.expand(1, 3, h, w), n * there, torch.cat([face_on, 0.8 * face_on], dim=1)),
        rays,
    )


def everything(x: float, dtype: torch.dtype = torch.float64, shape: tuple[int, ...] = (1, 3, 1, 5)) -> torch.Tensor:
    return torch.full(shape, x, dtype=dtype)


def test_numbers_of_0_give_the_prior() -> None:
    (p, rays), zero = prior(dtype=torch.float64), torch.zeros(1, 3, 4, 6, dtype=torch.float64)
    steep = (p.normal * rays).sum(dim=1, keepdim=True) < -FACING
    torch.testing.assert_close(learned_scale(zero, p.scale), p.scale)
    torch.testing.assert_close(
        torch.where(steep, learned_normal(zero, p.normal, rays), 0), torch.where(steep, p.normal, 0)
    )
    torch.testing.assert_close(learned_opacity(zero[:, :2], p.opacity), p.opacity)
    torch.testing.assert_close(learned_quaternion(zero[:, [0, 0, 0, 0]], p.normal), quaternion_of(p.normal))


@pytest.mark.parametrize("x", FAR.tolist())
def test_whatever_the_number_scale_and_opacity_stay_within_their_bounds(x: float) -> None:
    """softplus(6) / softplus(0) = 8.66 above, softplus(-6) / softplus(0) = 1/280 below."""
    ratio = float(growth(torch.tensor(x)))
    assert 1 / 281 < ratio < 8.67
    seen = learned_opacity(everything(x, shape=(1, 2, 1, 5)), everything(0.99, shape=(1, 2, 1, 5)))
    assert 0 < float(seen.min()) <= float(seen.max()) < 1


def test_no_number_is_lost_to_training() -> None:
    """A relative slope of more than 1e-8 as far as 10 000: a softplus of beta 100 has 1.9e-22 at -0.5."""
    x = FAR.clone().requires_grad_()
    torch.log(growth(x)).sum().backward()
    assert float(x.grad.min()) > 1e-8
    assert float(x.grad.max()) < 1.5


@pytest.mark.parametrize("kind", ["normal", "quaternion"])
@pytest.mark.parametrize("size", [0.0, 1.0, 1e3, 1e8])
def test_rotations_are_unit_and_normals_face_the_camera(kind: str, size: float) -> None:
    n, rays = facing(500)
    x = size * torch.randn(
        1, 3 if kind == "normal" else 4, 1, 500, generator=torch.Generator().manual_seed(2), dtype=torch.float64
    )
    found = learned_normal(x, n, rays) if kind == "normal" else learned_quaternion(x, n)
    torch.testing.assert_close((found**2).sum(dim=1), torch.ones(1, 1, 500, dtype=torch.float64))
    if kind == "normal":
        # the length before the last division is at most 1.06
        assert float((found * rays).sum(dim=1).max()) < -0.9 * FACING
        assert float((found * n).sum(dim=1).min()) > 0


def test_the_quaternion_of_a_normal_is_its_frame_without_twist() -> None:
    n, _ = facing(100)
    columns = torch.stack([*(torch.stack(t, dim=1) for t in tangents(*n.unbind(dim=1))), n], dim=2)[0, :, :, 0].permute(
        2, 0, 1
    )
    torch.testing.assert_close(rotations(quaternion_of(n)[0, :, 0].T), columns)


@pytest.mark.parametrize("name", ["limited", "growth", "normal", "quaternion", "opacity", "directions", "quaternions"])
def test_gradients_are_those_of_finite_differences(name: str) -> None:
    n, rays = facing(6)
    g = torch.Generator().manual_seed(3)
    x = 2 * torch.randn(1, 4, 1, 6, generator=g, dtype=torch.float64)
    c = torch.rand(1, 1, 1, 6, generator=g, dtype=torch.float64)
    q = torch.nn.functional.normalize(torch.randn(1, 4, 1, 6, generator=g, dtype=torch.float64), dim=1)
    functions = {
        "limited": limited,
        "growth": growth,
        "normal": lambda v: learned_normal(v[:, :3], n, rays),
        "quaternion": lambda v: learned_quaternion(v, n),
        "opacity": lambda v: learned_opacity(v[:, :2], everything(0.4, shape=(1, 2, 1, 6))),
        "directions": lambda v: blend_directions(n, learned_normal(v[:, :3], n, rays), c),
        "quaternions": lambda v: blend_quaternions(q, learned_quaternion(v, n), c),
    }
    assert torch.autograd.gradcheck(functions[name], x.requires_grad_())


def test_quaternions_blend_in_one_hemisphere() -> None:
    q = torch.nn.functional.normalize(
        torch.randn(1, 4, 1, 50, generator=torch.Generator().manual_seed(4), dtype=torch.float64), dim=1
    )
    half = everything(0.5, shape=(1, 1, 1, 50))
    torch.testing.assert_close(blend_quaternions(q, -q, half), q)


def test_opposite_normals_leave_the_prior_and_a_finite_gradient() -> None:
    n, _ = facing(5)
    other, c = (-n).requires_grad_(), everything(0.5, shape=(1, 1, 1, 5)).requires_grad_()
    found = blend_directions(n, other, c)
    found.sum().backward()
    torch.testing.assert_close(found, n)
    assert torch.isfinite(other.grad).all()
    assert torch.isfinite(c.grad).all()


def test_a_saturated_confidence_keeps_its_gradient() -> None:
    x = torch.tensor([-1e3, -40.0, 40.0, 1e3], requires_grad=True)
    confidence = torch.sigmoid(limited(x))
    confidence.sum().backward()
    assert float(x.grad.min()) > 1e-8  # sigmoid alone: 0 in float32
    assert 0.002 < float(confidence.detach().min()) < float(confidence.detach().max()) < 0.998


def test_opacity_is_blended_by_the_cosine_and_0_from_behind() -> None:
    faces = torch.tensor([0.8, 0.4]).reshape(1, 2, 1, 1)
    seen = [float(seen_opacity(faces, torch.tensor(c).reshape(1, 1, 1, 1))) for c in (1.0, 0.5, 1e-7, 0.0, -0.3)]
    assert seen == pytest.approx([0.8, 0.6, 0.4, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("upscale", [1, 2])
@pytest.mark.parametrize("rotation", ["normal", "quaternion"])
@pytest.mark.parametrize("opacity", [1, 2])
def test_untrained_heads_give_the_prior_and_shares_of_plus_1(upscale: int, rotation: str, opacity: int) -> None:
    p, rays = prior()
    features = torch.randn(1, 8, 4 // upscale, 6 // upscale, generator=torch.Generator().manual_seed(5))
    heads = Heads(8, rotation, opacity, upscale)
    learned = heads(features, p, rays)
    found = blend(p, learned)
    torch.testing.assert_close(found.disparity, p.disparity)
    torch.testing.assert_close(found.scale, p.scale)
    assert found.rotation.shape[1] == (3 if rotation == "normal" else 4)
    there = p.surface.expand_as(found.shares)
    torch.testing.assert_close(
        found.shares[there], torch.full_like(found.shares[there], torch.sigmoid(torch.tensor(1.0)))
    )
    assert not any(bool(m[..., 0].any()) for m in found)  # no surface, no Gaussian
    said = heads.numbers(features)
    change = moved(said, torch.ones(1, 1, 4, 6), heads.reach)
    # half of the refinement's move, and nothing of its own
    torch.testing.assert_close(change, torch.full_like(change, 0.5))
    (sum(m.sum() for m in found) + change.sum()).backward()
    assert all(torch.isfinite(v.grad).all() for v in heads.parameters())
    assert {name for name, last in heads.last.items() if bool(last.bias.grad.any())} == set(said) - {"shares"}


def test_a_move_is_taken_in_part_and_a_change_of_its_own_is_bounded() -> None:
    move = torch.tensor([-3.0, 0.0, 40.0]).reshape(1, 1, 1, 3)
    zero = torch.zeros_like(move)
    for x, share in ((0.0, 0.5), (1e6, 0.99753), (-1e6, 0.00247)):  # the logistic function of 0, 6 and -6
        found = moved({"move": zero + x, "disparity": zero}, move, 2.0)
        torch.testing.assert_close(found, share * move, rtol=2e-3, atol=0)
    own = moved({"move": zero, "disparity": zero + 1e6}, zero, 2.0)
    torch.testing.assert_close(own, torch.full_like(own, 2.0), rtol=1e-4, atol=0)


@pytest.mark.parametrize("of_disparity", [0.0, 1.0])
@pytest.mark.parametrize("of_looks", [0.0, 1.0])
def test_a_share_of_0_is_the_prior_and_one_of_1_what_is_learnt(of_disparity: float, of_looks: float) -> None:
    """Disparity has a share of its own: to the bit, where there is a surface."""
    p, _ = prior()
    shares = torch.tensor([of_disparity, of_looks])[None, :, None, None].expand(1, 2, *p.disparity.shape[2:])
    turned = torch.roll(p.normal, 1, dims=1)
    wild = HeadMaps(p.disparity + 3, p.scale * 5, turned, 1 - p.opacity, shares)
    found = blend(p, wild)
    for name, share, prior_s in (
        ("disparity", of_disparity, p.disparity),
        ("scale", of_looks, p.scale),
        ("opacity", of_looks, p.opacity),
        ("rotation", of_looks, p.normal),
    ):
        expected = torch.where(p.surface, getattr(wild, name) if share else prior_s, prior_s)
        torch.testing.assert_close(getattr(found, name), expected, rtol=1e-6 if share else 0, atol=0)


def test_what_heads_say_is_float32_within_autocast() -> None:
    """What their last layers read is rounded to bf16, what these say is not."""
    p, rays = prior()
    heads = Heads(8)
    for last in heads.last.values():
        torch.nn.init.normal_(last.weight, generator=torch.Generator().manual_seed(6))
    features = torch.randn(1, 8, 4, 6, generator=torch.Generator().manual_seed(7)).bfloat16()
    with torch.autocast("cpu", torch.bfloat16):
        inside = heads(features, p, rays)
    for a, b in zip(inside, heads(features.float(), p, rays), strict=True):
        assert a.dtype == torch.float32
        assert not torch.equal(a, a.bfloat16().float())
        torch.testing.assert_close(a, b, rtol=0.02, atol=0.02)  # eight bits, of each of eight sums


def test_features_of_another_resolution_are_refused() -> None:
    p, rays = prior()
    with pytest.raises(ValueError, match="upscale 2 do not give the prior's 4 x 6"):
        Heads(8, upscale=2)(torch.zeros(1, 8, 4, 6), p, rays)


@pytest.mark.parametrize("pose", [True, False])
@pytest.mark.parametrize("size", [(16, 24), (17, 23)])
@pytest.mark.parametrize("normalisation", ["group", "batch"])
def test_the_decoder_ends_at_the_finest_skip_and_every_input_counts(
    pose: bool, size: tuple[int, int], normalisation: str
) -> None:
    g = torch.Generator().manual_seed(8)
    sizes = [size, (-(-size[0] // 2), -(-size[1] // 2)), (-(-size[0] // 4), -(-size[1] // 4))]
    levels = [[torch.randn(2, 8, h, w, generator=g).requires_grad_() for h, w in sizes] for _ in range(3)]
    fused = torch.randn(2, 16, *sizes[-1], generator=g).requires_grad_()
    decoder = Decoder(16, [8] * 3, [8] * 3, [8] * 3 if pose else None, [8, 16, 24], normalisation)
    out = decoder(fused, levels[0], levels[1], levels[2] if pose else None)
    assert out.features.shape == (2, 8, *size)
    assert out.joint.shape == (2, 24, *sizes[-1])
    (out.features**2).sum().backward()
    for x in [fused, *levels[0], *levels[1], *(levels[2] if pose else [])]:
        assert bool(x.grad.any())


def test_a_decoder_says_which_inputs_it_misses() -> None:
    decoder = Decoder(8, [8], [8], [8], [8])
    x = torch.zeros(1, 8, 4, 4)
    with pytest.raises(ValueError, match="8 pose channels was given no pose"):
        decoder(x, [x], [x])
    with pytest.raises(ValueError, match="1 levels was given 2 image"):
        decoder(x, [x, x], [x], [x])
    with pytest.raises(ValueError, match="as many levels"):
        Decoder(8, [8, 8], [8], None, [8])


def test_a_quaternion_holds_the_normal_it_was_made_of() -> None:
    normal = torch.randn(2, 3, 4, 5, dtype=torch.float64)
    normal = normal / normal.norm(dim=1, keepdim=True)
    torch.testing.assert_close(normal_of(quaternion_of(normal)), normal)
    assert normal_of(normal) is normal
