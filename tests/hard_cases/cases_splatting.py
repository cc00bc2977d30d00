"""Records S1-S11: projecting one Gaussian, and the cut-offs of blending."""

from __future__ import annotations

import numpy as np
import torch

from posegaussian.stages.splatting.cpu import backend
from posegaussian.stages.splatting.cpu.projection import ACROSS, DOWN, SCALE
from posegaussian.stages.splatting.definition.projection import project
from posegaussian.stages.splatting.definition.scene import Cutoffs, Gaussians
from posegaussian.stages.splatting.quaternions import rotations
from tests.hard_cases import cases_pictures, naive
from tests.hard_cases.catalogue import Case, apart, worst
from tests.hard_cases.laws import drawn, relative, slope_error, to
from tests.support.gaussian_scenes import camera, draw, gaussians, turned_about_y

SINGLE, DOUBLE = torch.float32, torch.float64


def exact(g: Gaussians, cut: Cutoffs | None = None) -> torch.Tensor:
    """Alpha of the reference in float64."""
    return draw(to(g, DOUBLE), camera(), cut).alpha


def compiled(g: Gaussians, cut: Cutoffs | None = None) -> torch.Tensor:
    """Alpha of the compiled back end in float32, after every number and every gradient was found finite."""
    return drawn(to(g, SINGLE), camera(), cut)[0].alpha[0].detach()


def plain(g: Gaussians, low_pass: float = 0.0) -> torch.Tensor:
    """Alpha of the textbook's formula in float32."""
    return naive.splat(to(g, SINGLE), camera(), low_pass)[1]


AT_THE_CAMERA = [gaussians([0, 0, z], 0.01) for z in (-1.0, 0.0, 1e-6, 0.01, 0.0101, 0.2)]
BESIDE = [
    gaussians([3.0, 0, 0.3], 0.2),
    *(gaussians([2 * np.sin(a), 0, 2 * np.cos(a)], 0.05) for a in np.radians([40, 60, 70, 80, 85, 89])),
]
"""Balls beside the picture."""


def along_rays(g: Gaussians) -> torch.Tensor:
    """Alpha of a ball where each pixel's ray passes nearest to its middle: no projection, no approximation."""
    rows, columns = np.mgrid[:40, :48] + 0.5
    ray = np.stack([(columns - 24) / 50, (rows - 20) / 50, np.ones_like(rows)], axis=-1)
    m = g.mean[0].numpy()
    along = np.maximum(ray @ m, 0) / (ray * ray).sum(-1)
    missed = ((along[..., None] * ray - m) ** 2).sum(-1)
    return torch.as_tensor(float(g.opacity[0]) * np.exp(-0.5 * missed / float(g.scale[0, 0]) ** 2))


TINY = [gaussians([0.01, 0.005, 2.0], s) for s in (0.0, 1e-12, 1e-6, 1e-3)]
POINTS = [gaussians([0.0, 0.0, 2.0], s) for s in (0.0, 1e-12, 1e-9)]
ON_A_CENTRE = camera(cx=24.5, cy=20.5)
"""Points thinner than a variance can be divided by, exactly on a pixel's centre: nothing is to be seen of them."""


def mass_error(alpha: torch.Tensor, g: Gaussians) -> float:
    """Of a small Gaussian's sum over the picture, whose variances and the low pass's add."""
    expected = 2 * np.pi * (0.3 + (25 * float(g.scale[0, 0])) ** 2) * 0.8
    return abs(float(alpha.double().sum()) / expected - 1)


def energy_error(blurred: torch.Tensor, g: Gaussians) -> float:
    """Of the sum over the picture, against eight times as many pixels and no low pass."""
    fine = draw(to(g, DOUBLE), camera(48 * 8, 40 * 8, 50.0 * 8), Cutoffs(alpha_min=1e-6)).alpha
    return abs(float(blurred.double().sum()) / (float(fine.sum()) / 64) - 1)


def tiny_error() -> float:
    """Of widened Gaussians' mass; and what is drawn of points that nothing widens."""
    return worst(
        [
            *(mass_error(compiled(g, Cutoffs(low_pass=0.3)), g) for g in TINY),
            *(float(drawn(to(g, SINGLE), ON_A_CENTRE)[0].alpha.detach().max()) for g in POINTS),
        ]
    )


SMALL = [gaussians([0.01, 0.005, 2.0], s, 0.9) for s in (0.02, 0.04, 0.1)]
COMPENSATED = Cutoffs(low_pass=0.3, compensation=True, alpha_min=1e-6)


def needle(ratio: float) -> Gaussians:
    rotation = turned_about_y(30) @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])
    return gaussians([0.1, 0.05, 2.0], [[0.5, 0.5 / ratio, 0.5 / ratio]], rotation=rotation)


NEEDLES = [needle(r) for r in (1e2, 1e3, 1e4)]


def whitened_area(g: Gaussians) -> float:
    """Px^2 of a Gaussian's one-sigma ellipse over pi, by the roots of the conic."""
    w = project(g, camera(), Cutoffs()).whitening.double()[0]
    return 1 / abs(float(w[0] * w[3] - w[1] * w[2]))


def compiled_area(g: Gaussians) -> float:
    """The same of the compiled back end's record of the only Gaussian."""
    arrays = [backend.flat(getattr(to(g, SINGLE), n)) for n in backend.ATTRIBUTES]
    record = backend.project(arrays, backend.job(camera(), Cutoffs(), 3, 1))[0].astype(np.float64)
    return SCALE**2 / float(record[ACROSS] * record[DOWN])


def naive_area(g: Gaussians) -> float:
    return float(torch.sqrt(naive.project(g, camera()).det[0]))


def many_needles() -> Gaussians:
    """200 Gaussians of opacity 0.3 whose axes differ by up to six powers of ten."""
    rng = np.random.default_rng(0)
    z = rng.uniform(1.5, 4, 200)
    mean = np.stack([rng.uniform(-0.4, 0.4, 200) * z, rng.uniform(-0.3, 0.3, 200) * z, z], axis=1)
    turned = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    return Gaussians(
        *(
            torch.as_tensor(p, dtype=SINGLE)
            for p in (mean, turned, 10.0 ** rng.uniform(-5, 1, (200, 3)), np.full(200, 0.3), np.ones((200, 3)))
        )
    )


def naive_highest() -> float:
    """What is no number at all is left aside."""
    return float(torch.nan_to_num(naive.alphas(many_needles(), camera())[0], nan=0.0, posinf=torch.inf).max()) / 0.3 - 1


def highest_alpha() -> float:
    g = many_needles()
    each = (Gaussians(*(getattr(g, n)[i : i + 1] for n in Gaussians.__dataclass_fields__)) for i in range(200))
    return worst(float(draw(one, camera(), extras=()).alpha.max()) for one in each)


def stack() -> Gaussians:
    z = torch.linspace(1, 2, 100, dtype=DOUBLE)
    return gaussians(torch.stack([z * 0, z * 0, z], dim=1), 10.0, 1.0)


def naive_stack_gradient() -> torch.Tensor:
    """The slope of alpha over opacity in one pixel under a stack,
    by the transmittance behind all over (1 - alpha) of each."""
    alpha = torch.ones(100)
    return torch.prod(1 - alpha) / (1 - alpha)


def stack_gradient_error() -> float:
    """Of the gradients of all attributes."""
    single, double = (drawn(to(stack(), dtype), camera())[1] for dtype in (SINGLE, DOUBLE))
    return worst(relative(single[n], double[n]) for n in double)


def naive_cap_gradient(opacity: float) -> float:
    """Forward caps alpha at 0.999, backward at 0.99, as one published renderer has it: the slope by differences,
    less the gradient."""
    low, high = (min(opacity + step, 0.999) for step in (-1e-4, 1e-4))
    return abs((high - low) / 2e-4 - float(opacity < 0.99))


BESIDE_THE_CAP = (0.985, 0.9899, 0.9901, 0.999)


def cap_error(opacity: float) -> float:
    """Of the slope over opacity: the reference's against differences, the compiled back end's against the reference.
    A pixel's centre lies on the first Gaussian's, so that its opacity is seen whole."""
    g, cam = gaussians([[0.0, 0, 2.0], [0.1, 0.05, 2.5]], 0.3, torch.tensor([opacity, 0.7])), camera(9, 9, 12.0)
    single = to(g, SINGLE)
    ours, true = (drawn(h, cam)[1]["opacity"] for h in (single, to(single, DOUBLE)))
    return worst([slope_error(g, cam, "opacity"), relative(ours, true)])


def naive_coverage() -> float:
    """Two at the cap of 0.99, blended until the transmittance would fall below 1e-4, in float32."""
    transmittance = np.float32(1)
    for _ in range(2):
        behind = transmittance * (np.float32(1) - np.float32(0.99))
        if behind < np.float32(1e-4):
            break
        transmittance = behind
    return abs(0.9999 - (1 - float(transmittance)))


FAINT = (0.0, 1e-9, 1 / 255 - 1e-6, 1 / 255 + 1e-6)


def naive_reach(opacity: float) -> float:
    """Standard deviations after which alpha is below 1/255."""
    return float(np.sqrt(2 * np.log(np.float32(255 * opacity))))


def faint_error(opacity: float) -> float:
    """A pixel centre lies exactly on the Gaussian's."""
    return apart(compiled(gaussians([0.02, 0.02, 2.0], 0.5, opacity)).max(), opacity if opacity >= 1 / 255 else 0.0)


LENGTHS = (0.0, 1e-30, 1e-20, 1.0, 1e20)


def quaternion(length: float) -> torch.Tensor:
    return (torch.tensor([[0.5, -0.1, 0.7, 0.3]], dtype=DOUBLE) * length).to(SINGLE)


def naive_rotation(q: torch.Tensor) -> torch.Tensor:
    """[3, 3] of a quaternion divided by its length."""
    w, x, y, z = (q / torch.sqrt((q * q).sum(dim=1, keepdim=True)))[0]
    return torch.stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y - w * z),
            2 * (x * z + w * y),
            2 * (x * y + w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z - w * x),
            2 * (x * z - w * y),
            2 * (y * z + w * x),
            1 - 2 * (x * x + y * y),
        ]
    ).reshape(3, 3)


def rotation_error(length: float) -> float:
    """Against the rotation of the quaternion of length 1; one of length 0 has none, and says so."""
    found = rotations(quaternion(length))[0]
    if length == 0:
        return 0.0 if bool(torch.isnan(found).all()) else 1.0
    return apart(found, rotations(quaternion(1.0).double())[0])


CASES = (
    Case(
        "S1",
        "a point at or behind the camera",
        "depth 0 divides by zero, and what lies behind is drawn mirrored",
        "alpha",
        lambda: worst(apart(plain(g), exact(g)) for g in AT_THE_CAMERA),
        lambda: worst(apart(compiled(g), exact(g)) for g in AT_THE_CAMERA),
        2e-5,
        "culled at z <= 0.01 m; beyond, float32 of alphas below 1",
    ),
    Case(
        "S2",
        "a ball far beside the picture",
        "the linear approximation stretches like 1/cos² and smears it over the picture",
        "alpha",
        lambda: worst(apart(plain(g), along_rays(g)) for g in BESIDE),
        lambda: worst(apart(compiled(g), along_rays(g)) for g in BESIDE),
        1 / 255,
        "approximated inside 1.3 times the frustum; what 8 bits cannot show remains",
    ),
    Case(
        "S3",
        "smaller than a pixel, down to a point",
        "the covariance's determinant is 0 and its inverse is not a number",
        "of its mass",
        lambda: worst(mass_error(plain(g), g) for g in TINY),
        tiny_error,
        0.02,
        "the tail below 1/255 holds 0.5 % of the mass, sampling at 0.55 px errs by 1 %",
    ),
    Case(
        "S4",
        "smaller than a pixel, widened against aliasing",
        "widened at full opacity, it grows brighter",
        "of its mass",
        lambda: worst(energy_error(plain(g, 0.3), g) for g in SMALL),
        lambda: worst(energy_error(compiled(g, COMPENSATED), g) for g in SMALL),
        0.01,
        "opacity is lowered by the ratio of the areas; sampling remains",
    ),
    Case(
        "S5",
        "a needle, 1:100 to 1:10000",
        "a c - b² cancels: its width is wrong, or the root of a negative number",
        "of its area",
        lambda: worst(abs(naive_area(to(g, SINGLE)) / whitened_area(g) - 1) for g in NEEDLES),
        lambda: worst(
            abs(area / whitened_area(g) - 1)
            for g in NEEDLES
            for area in (whitened_area(to(g, SINGLE)), compiled_area(g))
        ),
        2e-3,
        "the squared length of a cross product loses the digits of the ratio once: 1e4 times 2e-7",
    ),
    Case(
        "S6",
        "a conic that is not positive",
        "exp of a positive number: alpha above its opacity, up to infinity",
        "of its opacity",
        naive_highest,
        lambda: max(0.0, highest_alpha() / 0.3 - 1),
        5e-7,
        "the exponent is a sum of two squares; exp in float32 errs by 4 ulp",
    ),
    Case(
        "S7",
        "a stack of a hundred opaque Gaussians",
        "the gradient divides by 1 - alpha = 0",
        "of the gradient",
        lambda: apart(naive_stack_gradient(), torch.zeros(100)),
        stack_gradient_error,
        5e-5,
        "alpha is capped at 0.99, and 1 - 0.99 in float32 is off by 6e-6 of itself",
    ),
    Case(
        "S8",
        "opacities beside the cap of alpha",
        "forward and backward cap at different values: the gradient is gone",
        "of the slope",
        lambda: worst(naive_cap_gradient(o) for o in BESIDE_THE_CAP),
        lambda: worst(cap_error(o) for o in BESIDE_THE_CAP),
        1e-5,
        "one record of cut-offs for both; central differences err by 1e-7",
    ),
    Case(
        "S9",
        "the transmittance exactly at the stop",
        "0.01² rounds to below 1e-4, and the second opaque Gaussian is dropped: 1 % too dark",
        "alpha",
        naive_coverage,
        lambda: apart(compiled(gaussians([[0.0, 0, 1.0], [0, 0, 2.0]], 10.0, 1.0)), 0.9999),
        1e-6,
        "the stop lies just below 0.01²; float32",
    ),
    Case(
        "S10",
        "opacity 0, or about 1/255",
        "the box is the root of a negative logarithm",
        "alpha",
        lambda: worst(naive_reach(o) for o in FAINT),
        lambda: worst(faint_error(o) for o in FAINT),
        1e-6,
        "left out before any logarithm; float32",
    ),
    Case(
        "S11",
        "quaternions of length 0, 1e-30, 1e20",
        "0/0, and squares that under- or overflow",
        "of a rotation",
        lambda: worst(
            apart(naive_rotation(quaternion(n)), rotations(quaternion(1.0).double())[0]) for n in LENGTHS[1:]
        ),
        lambda: worst(rotation_error(n) for n in LENGTHS),
        1e-6,
        "divided by the largest component first; length 0 is masked and counted; float32",
    ),
    *cases_pictures.CASES,
)
