"""Records D2b-D12b of the matching network: correlation, coordinates and the coding of depth as disparity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
import torch.nn.functional as F

from posegaussian.stages.network.model.correlation import Correlation, columns_of, volume_bytes
from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.refine import DepthRefinement
from posegaussian.stages.network.model.update import convex_weights, upsample
from tests.hard_cases.catalogue import Case, apart, worst

WIDTHS = (1, 2, 3, 5, 7, 9, 12, 13)
"""Of feature maps; four levels halve the width three times."""


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def loud() -> tuple[torch.Tensor, torch.Tensor]:
    """Features of 192 channels as autocast hands them on:
    float16, some 30 of size, what is at column j is there, too."""
    features = (30 * F.normalize(random(1, 192, 2, 16), dim=1) * math.sqrt(192)).half()
    return features, features


def products(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """[B, h, w, w'] in float64."""
    return torch.einsum("bchi,bchj->bhij", first.double(), second.double()) / math.sqrt(first.shape[1])


def naive_products() -> float:
    """Summed in float16 and then divided by the root of the channels."""
    first, second = loud()
    found = (first[..., :, None] * second[..., None, :]).sum(1) / math.sqrt(first.shape[1])
    return apart(
        found.double() / products(first, second).abs().max(),
        products(first, second) / products(first, second).abs().max(),
    )


def products_error() -> float:
    """Of the largest."""
    first, second = loud()
    true = products(first, second)
    with torch.autocast("cpu", torch.float16):
        volume = Correlation(first, second, 1, 0).volume
    assert volume is not None
    return apart(volume[0].double() / true.abs().max(), true / true.abs().max())


DISPARITIES = torch.linspace(0.3, 3.7, 512).reshape(1, 1, 1, 512)
"""In a picture whose features are 512 columns wide."""


def naive_columns() -> float:
    """In the bfloat16 of everything around it."""
    return apart(
        (torch.arange(512).bfloat16() - DISPARITIES.bfloat16()).float(), torch.arange(512) - DISPARITIES.double()
    )


def columns_error() -> float:
    """Of disparities in float32, and of what autocast has made of them."""
    with torch.autocast("cpu", torch.bfloat16):
        return worst(
            apart(columns_of(given), torch.arange(512) - given.double())
            for given in (DISPARITIES, DISPARITIES.bfloat16())
        )


def four_k() -> tuple[int, int, int, int]:
    """Batch, channels, height and width of the features of 4096 x 2304 px at an eighth: two directions."""
    return 2, 96, 288, 512


def naive_memory() -> float:
    """Every cell with every cell of its row, on four levels: in sizes of the features themselves."""
    batch, channels, height, width = four_k()
    return volume_bytes(batch, height, width, width, 4) / (4 * batch * channels * height * width)


@cache
def memory() -> float:
    """What ours keeps, measured on a strip of that picture with the budget that falls to it. A look-up without
    gradients has two more at a time."""
    batch, channels, height, width = four_k()
    strip = random(batch, channels, 1, width)
    found = Correlation(strip, strip, 4, 4, budget=2**28 // height)
    assert found.volume is None
    kept = {t.data_ptr(): t.numel() for t in (found.first, *found.second)}
    return sum(kept.values()) / strip.numel()


def pooled_truth(line: torch.Tensor, level: int) -> torch.Tensor:
    """Means of 2^level columns [h, w'], the last of what is left; float64."""
    return torch.stack([part.mean(-1) for part in line.double().split(2**level, dim=-1)], dim=-1)


def naive_pyramid(width: int) -> float:
    """Halved again and again: the last of an odd number of columns falls out,
    and a map of one column cannot be halved."""
    first, second = random(1, 6, 2, width), random(1, 6, 2, width, seed=1)
    volume = (products(first, second)[0]).flatten(0, 1)[:, None]
    errors = []
    for level in range(4):
        true = pooled_truth(products(first, second)[0], level).flatten(0, 1)[:, None]
        errors.append(apart(F.pad(volume, (0, true.shape[-1] - volume.shape[-1])), true))
        volume = F.avg_pool1d(volume, 2)
    return worst(errors)


def pyramid_error(width: int) -> float:
    first, second = random(1, 6, 2, width), random(1, 6, 2, width, seed=1)
    volume = Correlation(first, second, 4, 4).volume
    assert volume is not None
    return worst(apart(volume[level], pooled_truth(products(first, second)[0], level)[None]) for level in range(4))


def level_places(level: int) -> tuple[Correlation, torch.Tensor]:
    """Features whose correlation is the column of the other view, and columns in its middle."""
    first = torch.ones(1, 1, 1, 64)
    return Correlation(first, torch.arange(64.0).reshape(1, 1, 1, 64), level + 1, 0), torch.linspace(
        20, 40, 64
    ).reshape(1, 1, 1, 64)


def naive_level_place() -> float:
    """A column divided by 2^level, as is usual: cells are read half a cell from where they are."""
    correlation, columns = level_places(3)
    assert correlation.volume is not None
    place = columns.flatten() / 8
    left = place.floor().long()
    line = correlation.volume[3][0, 0, 0]
    return apart(torch.lerp(line[left], line[left + 1], place - left), columns.flatten())


def level_place_error() -> float:
    return worst(
        apart(level_places(level)[0].look_up(level_places(level)[1])[:, level], level_places(level)[1][:, 0])
        for level in range(4)
    )


FAR_OFF = torch.tensor([-1e30, -1e9, -7.0, -0.5, 4.5, 11.0, 1e9, 1e30]).reshape(1, 1, 1, 8)
"""Columns beside a map of 5, of which two lie within a cell of it."""


def fades() -> torch.Tensor:
    """What counts nothing beside the map: 1 inside."""
    return torch.tensor([0, 0, 0, 0.5, 0.5, 0, 0, 0]).reshape(1, 1, 1, 8)


def naive_beside() -> float:
    """The last column that there is, as a clamped index gives it: the rim matches everything."""
    return apart(torch.ones(5)[FAR_OFF.double().round().clamp(0, 4).long()], fades())


def beside_error() -> float:
    first, second = torch.ones(1, 1, 1, 8), torch.ones(1, 1, 1, 5)
    return worst(apart(Correlation(first, second, 1, 0, budget).look_up(FAR_OFF), fades()) for budget in (2**20, 0))


NEAR, FAR = 0.5, 8.0


def gone(scale: float) -> tuple[torch.Tensor, Coding]:
    """Disparities, px, that steps of a recurrence may come to, at infinity and on either side of it;
    the coding of their pair."""
    code = Coding(*(torch.tensor([v], dtype=torch.float64) for v in (scale, -1500.0, NEAR, FAR)))
    return torch.tensor([-math.inf, -1e9, -1501.0, -1500.0, -1499.9999, 0.0, 1e9, math.inf]).reshape(1, 1, 2, 4), code


def outside(depth: torch.Tensor) -> float:
    """Metres by which a depth lies outside its bounds; infinite where it is infinite, NaN where it is no number."""
    return float(torch.maximum(NEAR - depth.double(), depth.double() - FAR).clamp(min=0).max())


def naive_depth() -> float:
    disparity, code = gone(3000.0)
    return outside(code.scale / (disparity - code.offset + 1e-8))


def depth_outside() -> float:
    return worst(outside(code.depth(disparity)) for disparity, code in (gone(s) for s in (3000.0, -3000.0)))


def naive_wild() -> float:
    """Steps that add up: five times 400 px nearer to infinity, and beyond it."""
    _, code = gone(3000.0)
    return outside(code.scale / (torch.zeros(1) - 5 * 400.0 - code.offset))


@cache
def wild_outside() -> float:
    """A network of large random weights, five steps, from a start that holds what is no number."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        net = DepthRefinement(4, 6, 2, 1, 4)
        for layer in (net.update.delta[-1], net.update.mask[-1]):
            torch.nn.init.normal_(layer.weight, std=1e4)
    start = random(1, 1, 16, 20)
    start[..., :7], start[..., 7:9] = math.nan, math.inf
    _, code = gone(3000.0)
    with torch.no_grad():
        found = net(random(1, 4, 4, 5), random(1, 4, 4, 5, seed=1), start, code, 5)
    return worst([*(outside(code.depth(d)) for d in found.disparities), *(beyond(d, code) for d in found.disparities)])


def beyond(disparity: torch.Tensor, code: Coding) -> float:
    """Px by which disparities lie outside the bounds that their coding has in float32."""
    low, high = (float(b.float()) for b in code.bounds())
    return float(torch.maximum(low - disparity, disparity - high).clamp(min=0).max())


class Runaway(torch.nn.Module):
    """In the place of a recurrence: given changes, cells, step by step, whatever is seen."""

    def __init__(self, changes: Sequence[float]) -> None:
        super().__init__()
        self.changes = iter(changes)

    def forward(self, state: torch.Tensor, context: torch.Tensor, seen: torch.Tensor, moved: torch.Tensor) -> Any:
        return state, torch.full_like(moved, next(self.changes))

    def weights(self, state: torch.Tensor) -> torch.Tensor:
        return convex_weights(torch.zeros(1, 9 * 16, *state.shape[2:]), 4)


def moved(start: float, changes: Sequence[float]) -> torch.Tensor:
    """Disparities [1, 1, 16, 20], px, after such changes of a start, px, that is the same everywhere."""
    net = DepthRefinement(4, 6, 2, 1, 4)
    net.update = Runaway(changes)  # type: ignore[assignment]
    _, code = gone(3000.0)
    with torch.no_grad():
        begin = torch.full((1, 1, 16, 20), start)
        return net(random(1, 4, 4, 5), random(1, 4, 4, 5, seed=1), begin, code, len(changes)).disparities[-1]


def return_error() -> float:
    """Px by which a recurrence that turns back after four steps of 400 cells beyond a bound misses the place one step,
    of a cell, within it."""
    low, high = (float(b) for b in gone(3000.0)[1].bounds())
    return worst(
        apart(moved(0.0, [*([400 * sign] * 4), -sign]), moved(bound - 4 * sign, [0.0]))
        for sign, bound in ((-1.0, low), (1.0, high))
    )


def naive_rim() -> float:
    """Neighbours beside the picture taken as 0, as `unfold` pads."""
    cells = torch.full((1, 1, 3, 4), 100.0)
    weights = convex_weights(torch.zeros(1, 9 * 16, 3, 4), 4)
    around = F.unfold(cells, 3, padding=1).reshape(1, 9, 3, 4).permute(0, 2, 3, 1)
    return apart(around[..., None, :] @ weights, 100.0)


def rim_error() -> float:
    return apart(upsample(torch.full((1, 1, 3, 4), 100.0), convex_weights(torch.zeros(1, 9 * 16, 3, 4), 4)), 100.0)


CASES = (
    Case(
        "D2b",
        "columns of a look-up in bfloat16",
        "eight bits for 512 columns: a column off",
        "columns",
        naive_columns,
        columns_error,
        3.1e-5,
        "at least float32, even under autocast",
    ),
    Case(
        "D3b",
        "disparity at infinity and beyond it, of wide pairs",
        "1 / (d + 1e-8): hundreds of millions of kilometres off, or behind the camera",
        "m beyond the bounds",
        naive_depth,
        depth_outside,
        0.0,
        "held between a nearest and a farthest depth in float64",
    ),
    Case(
        "D10b",
        "a recurrence that runs away",
        "its steps add up beyond infinity, and depth turns negative",
        "m, or px, beyond the bounds",
        naive_wild,
        lambda: worst([wild_outside(), return_error()]),
        0.0,
        "held after each step, so that the next leads back; a start that is no number takes the picture's mean",
    ),
    Case(
        "D6",
        "correlation of 192 channels in float16",
        "overflows before it is divided by the root of the channels",
        "of the largest",
        naive_products,
        products_error,
        1e-6,
        "scaled first, and multiplied in float32",
    ),
    Case(
        "D7",
        "correlation of 4096 x 2304 px",
        "every column with every column: grows with height x width squared",
        "x the features",
        naive_memory,
        memory,
        3.0,
        "above 256 MiB products are made at the look-up, and only the features of both views are kept",
    ),
    Case(
        "D8",
        "feature maps of odd and of few columns",
        "halving loses the last column, and cannot halve one",
        "of a product",
        lambda: worst(naive_pyramid(w) for w in WIDTHS),
        lambda: worst(pyramid_error(w) for w in WIDTHS),
        2e-6,
        "a cell is the mean of the columns that are there; float32",
    ),
    Case(
        "D9b",
        "looking up columns beside the other picture",
        "a clamped index: whatever leaves the picture matches its rim",
        "of a match",
        naive_beside,
        beside_error,
        0.0,
        "falls linearly to 0 over one cell, and stays 0",
    ),
    Case(
        "D12b",
        "convex up-sampling at the rim",
        "neighbours beside the picture are 0, and pull disparity to 0",
        "px of 100",
        naive_rim,
        rim_error,
        3e-5,
        "the rim's own value stands beside it; float32",
    ),
    Case(
        "D11b",
        "coarse levels of a correlation",
        "column / 2^level reads half a cell beside the place",
        "columns",
        naive_level_place,
        level_place_error,
        1e-5,
        "cells are looked up at their centres; float32",
    ),
)
