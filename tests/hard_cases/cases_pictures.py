"""Records S12-S22: many Gaussians, whole pictures, and the bytes they become."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from posegaussian.dags.export.background import over
from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.splatting.definition.scene import Cutoffs, Gaussians
from tests.hard_cases import naive
from tests.hard_cases.catalogue import Case, apart, worst
from tests.hard_cases.laws import FIELDS, drawn, pictures, relative, to
from tests.support.gaussian_scenes import camera, cloud, draw, gaussians, turned_about_y

SINGLE, DOUBLE = torch.float32, torch.float64


def huge(scale: float) -> Gaussians:
    return gaussians([[0, 0, 2.0], [0.3, 0, 3.0]], scale, 0.5, dtype=SINGLE)


def huge_error() -> float:
    """Two sheets of a kilometre let a quarter through; at 1e30 m every number is finite all the same, and both are
    counted as left out."""
    left_out = drawn(huge(1e30), camera())[0].masked
    return apart(drawn(huge(1e3), camera())[0].alpha, 0.75) if left_out == (2,) else np.inf


def poisoned(name: str, bad: float) -> Gaussians:
    """Twenty Gaussians, of which the eighth has one attribute that is no finite number."""
    g = cloud(20, dtype=SINGLE)
    broken = dataclasses.replace(g, **{name: getattr(g, name).clone()})
    getattr(broken, name)[7, ...] = bad
    return broken


POISONS = [(n, b) for n in FIELDS for b in (np.nan, np.inf, -np.inf)]


def without_it() -> Gaussians:
    g = cloud(20, dtype=SINGLE)
    rest = [i for i in range(20) if i != 7]
    return Gaussians(*(getattr(g, n)[rest] for n in FIELDS))


def poison_error(name: str, bad: float) -> float:
    """Against the picture without it; infinite where it is not counted."""
    out = drawn(poisoned(name, bad), camera())[0]
    return apart(out.color, draw(without_it(), camera()).color[None]) if out.masked == (1,) else np.inf


ODD = [(1, 1), (3, 50), (33, 17)]
"""Widths and heights."""


def naive_tiles(size: tuple[int, int]) -> torch.Tensor:
    """Tiles of 16 pixels, as many as width / 16."""
    whole = naive.splat(cloud(9, dtype=SINGLE), camera(*size, focal=20.0))[1]
    painted = torch.zeros_like(whole)
    for y in range(size[1] // 16):
        for x in range(size[0] // 16):
            block = (slice(16 * y, 16 * y + 16), slice(16 * x, 16 * x + 16))
            painted[block] = whole[block]
    return painted


def odd_error(size: tuple[int, int]) -> float:
    """Of a picture of odd size; an empty scene is an empty picture."""
    cam = camera(*size, focal=20.0)
    assert not drawn(cloud(0, dtype=SINGLE), cam)[0].alpha.any()
    return apart(drawn(cloud(9, dtype=SINGLE), cam)[0].alpha[0], draw(to(cloud(9, dtype=SINGLE), DOUBLE), cam).alpha)


def tied() -> Gaussians:
    """Five Gaussians of five colours at one depth, and one behind, so that there is something to sort."""
    behind = gaussians([0.0, 0, 3.0], 0.5, 0.5, (0.2, 0.4, 0.6), dtype=SINGLE)
    equal = gaussians(torch.tensor([[0.0, 0, 2.0]]).repeat(5, 1), 0.5, 0.5, torch.eye(5, 3), dtype=SINGLE)
    return Gaussians.concatenate([behind, equal])


def naive_ties() -> float:
    """The same picture blended front to back, and from the back by descending depth."""
    alpha, z = naive.alphas(tied(), camera())
    front = torch.argsort(z, stable=True)
    back = torch.argsort(-z, stable=True).flip(0)
    return apart(*(naive.blend(alpha[o], tied().color[o])[0] for o in (front, back)))


PLACES = [(24.0, 20.0, 24.0, 20.0), (17.3, 12.8, 24.0, 20.0), (30.25, 9.6, 24.0, 20.0)]
ASIDE = [(17.3, 12.8, 14.4, 31.0), (30.25, 9.6, 14.4, 31.0)]
"""(u, v, cx, cy): where a Gaussian projects, px, and the principal point."""


def placed(u: float, v: float, cx: float, cy: float) -> Gaussians:
    return gaussians([(u - cx) / 50 * 2, (v - cy) / 50 * 2, 2.0], 0.05, dtype=SINGLE)


def off_centre(alpha: torch.Tensor, u: float, v: float) -> float:
    """Px from where a Gaussian projects to the middle of its picture."""
    rows, columns = torch.meshgrid(torch.arange(40) + 0.5, torch.arange(48) + 0.5, indexing="ij")
    mass = alpha.double() / alpha.double().sum()
    return float(torch.hypot((mass * columns).sum() - u, (mass * rows).sum() - v))


UNCUT = Cutoffs(alpha_min=1e-9, alpha_max=1.0, transmittance_stop=0.0)


def before_white() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Colour and alpha of a cloud on black, and the same cloud before a white sheet."""
    g, cut = cloud(60, dtype=SINGLE), Cutoffs(alpha_max=0.999999, transmittance_stop=-1.0)
    sheet = gaussians([0, 0, 1e3], 1e6, 1.0, (1.0, 1.0, 1.0), dtype=SINGLE)
    black, white = draw(g, camera(), cut), draw(Gaussians.concatenate([g, sheet]), camera(), cut)
    return black.color, black.alpha[..., None], white.color


def naive_background() -> float:
    """The usual "over": alpha times colour plus the rest of the background;
    but the colour has been multiplied already."""
    color, alpha, white = before_white()
    return apart(alpha * color + (1 - alpha), white)


def background_error() -> float:
    """Of colour put before white, and, in units of a grey level, of bytes that an export puts before it."""
    color, alpha, white = before_white()
    premultiplied, coverage = quantise(color), quantise(alpha[..., 0])
    exported = over(premultiplied, coverage, np.full_like(premultiplied, 255))
    expected = np.minimum(premultiplied + (255.0 - coverage)[..., None], 255)
    return worst([apart(color + (1 - alpha), white), apart(exported, expected)])


def wrapped(values: torch.Tensor) -> np.ndarray:
    """Bytes as a plain conversion makes them."""
    return (values.double().numpy() * 255).astype(np.int64).astype(np.uint8)


def negative() -> torch.Tensor:
    return draw(dataclasses.replace(cloud(30, dtype=SINGLE), color=torch.full((30, 3), -5.0)), camera()).color


LIGHT = torch.tensor([1.2, 1.0000001, 1.0, 0.5, 0.25, -0.1])


def byte_error(found: np.ndarray) -> float:
    return apart(found, LIGHT.clamp(0, 1).double() * 255)


def naive_sum() -> float:
    """One gradient summed as threads may deliver it: a hundred thousand float32 terms in two orders."""
    rng = np.random.default_rng(0)
    terms = rng.normal(size=100_000).astype(np.float32)
    total, shuffled = (np.add.accumulate(t)[-1] for t in (terms, rng.permutation(terms)))
    return abs(float(total) - float(shuffled)) / float(np.sqrt(len(terms)))


def thread_error() -> float:
    """Pictures and gradients on one, two and three threads."""
    g = cloud(2000, dtype=SINGLE)
    g = dataclasses.replace(g, scale=g.scale * 0.2)
    one, gradients = drawn(g, camera(100, 80, 100.0))
    found = 0.0
    for threads in (2, 3):
        out, others = drawn(g, camera(100, 80, 100.0), threads=threads)
        found = worst(
            [
                found,
                *(apart(a, b) for a, b in zip(pictures(one), pictures(out), strict=True)),
                *(apart(gradients[n], others[n]) for n in gradients),
            ]
        )
    return found


EDGE_ON = [
    gaussians([0.0, 0.02, 2.0], [[0.1, 0.1, t]], rotation=turned_about_y(d), dtype=SINGLE)
    for d in (89.99, 90.0)
    for t in (0.0, 1e-6)
]
COLUMN = camera(cx=23.5)
"""The discs' plane holds this camera's centre, and their picture a column of pixel centres."""


def disc_error(alpha: torch.Tensor) -> float:
    """Px covered by a disc of which next to nothing is to be seen: 0.005 px at 89.99 degrees."""
    return float(alpha.double().sum())


COMPENSATED = Cutoffs(low_pass=0.3, compensation=True)


def drawn_disc(g: Gaussians) -> torch.Tensor:
    drawn(g, COLUMN)
    return drawn(g, COLUMN, COMPENSATED)[0].alpha.detach()


ACROSS = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
"""A quarter turn about the vertical without rounding: the area that is left is 0 and not next to it."""


def floor_error() -> float:
    """Of the opacity of a disc without any area of its own, as a share: 0.005 of it is left; and of the slopes over
    its opacity and its scales, which are those of float64."""
    disc = gaussians([0.0, 0.02, 2.0], [[0.1, 0.1, 0.0]], opacity=0.9, rotation=ACROSS, dtype=SINGLE)
    out, slopes = drawn(disc, COLUMN, COMPENSATED)
    seen = float(out.alpha.detach().max()) / (0.9 * COMPENSATED.compensation_min)
    true = drawn(to(disc, DOUBLE), COLUMN, COMPENSATED)[1]
    return worst([abs(seen - 1), *(relative(slopes[name], true[name]) for name in ("opacity", "scale"))])


CASES = (
    Case(
        "S12",
        "scales of a kilometre, or of 1e30 m",
        "the covariance overflows: infinity minus infinity",
        "alpha",
        lambda: worst(apart(naive.splat(huge(s), camera())[1], 0.75) for s in (1e3, 1e30)),
        huge_error,
        1e-4,
        "what overflows is masked and counted; lists of 2^32 pairs are refused by name",
    ),
    Case(
        "S13",
        "NaN or infinity in any attribute",
        "one such Gaussian blackens the picture",
        "colour",
        lambda: worst(
            apart(naive.splat(poisoned(n, b), camera())[0], naive.splat(without_it(), camera())[0]) for n, b in POISONS
        ),
        lambda: worst(poison_error(n, b) for n, b in POISONS),
        0.0,
        "the same bits as without it: it is masked, counted and reported",
    ),
    Case(
        "S14",
        "no Gaussian, or pictures of 1 x 1, 3 x 50, 33 x 17",
        "the last columns and rows are no whole tile and stay empty",
        "alpha",
        lambda: worst(
            apart(naive_tiles(s), naive.splat(cloud(9, dtype=SINGLE), camera(*s, focal=20.0))[1]) for s in ODD
        ),
        lambda: worst(odd_error(s) for s in ODD),
        2e-5,
        "float32 of alphas below 1",
    ),
    Case(
        "S15",
        "equal depths",
        "front-to-back and back-to-front order disagree about ties, so forward and backward do",
        "colour",
        naive_ties,
        lambda: apart(draw(tied(), camera()).color, draw(to(tied(), DOUBLE), camera()).color),
        2e-5,
        "a stable sort, once for both passes: ties keep the input's order; float32",
    ),
    Case(
        "S16",
        "where a pixel's centre is",
        "integer centres under a camera whose centres are at a half",
        "px",
        lambda: worst(off_centre(naive.splat(placed(*p), camera(), centre=0.0)[1], *p[:2]) for p in PLACES),
        lambda: worst(off_centre(draw(placed(*p), camera(), UNCUT).alpha, *p[:2]) for p in PLACES),
        1e-4,
        "float32 positions of tens of px, weighed over the picture",
    ),
    Case(
        "S17",
        "a principal point at 0.3 of the width",
        "the middle of the picture is taken instead",
        "px",
        lambda: worst(off_centre(naive.splat(placed(*p), camera())[1], *p[:2]) for p in ASIDE),
        lambda: worst(off_centre(draw(placed(*p), camera(cx=p[2], cy=p[3]), UNCUT).alpha, *p[:2]) for p in ASIDE),
        1e-4,
        "as S16",
    ),
    Case(
        "S18",
        "a picture before another background",
        "premultiplied colour is multiplied by alpha once more: dark rims",
        "colour",
        naive_background,
        background_error,
        3e-6,
        "colour plus (1 - alpha) background; float32 sums of sixty terms",
    ),
    Case(
        "S19",
        "negative colours",
        "bytes wrap: darker than black becomes bright",
        "grey levels",
        lambda: apart(wrapped(negative()), 0),
        lambda: apart(quantise(negative()), 0),
        0.0,
        "blended as they are, written as black; splat files' colours are cut at 0 as 3DGS defines",
    ),
    Case(
        "S20",
        "the order of floating-point sums",
        "gradients added in the order in which threads come differ from run to run",
        "of a gradient",
        naive_sum,
        thread_error,
        0.0,
        "a slot for every contribution and one fixed order: the same bits on 1, 2, 3 threads",
    ),
    Case(
        "S21",
        "values above 1 and below 0 as bytes",
        "1.2 wraps to 50, -0.1 to 231",
        "grey levels",
        lambda: byte_error(wrapped(LIGHT)),
        lambda: byte_error(quantise(LIGHT)),
        0.5,
        "clipped, then rounded",
    ),
    Case(
        "S22",
        "a disc seen edge-on, at 89.99 and 90 degrees, without thickness",
        "the inverse of a singular covariance: 0 times infinity, or a line as bright as a face",
        "px",
        lambda: worst(disc_error(naive.splat(g, COLUMN)[1]) for g in EDGE_ON),
        lambda: worst([*(disc_error(drawn_disc(g)) for g in EDGE_ON), floor_error()]),
        0.05,
        "widened by 0.3 px² at an opacity lowered to no less than 0.005",
    ),
)
