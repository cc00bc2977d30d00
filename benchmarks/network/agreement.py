"""Where there is no truth: how far a view's depths contradict what the other views show, for several depths of the same
capture.

A view's pixels are carried by its depth into a second view. Measured over the *union*: every pixel that one of the
depths at least says both views see (the second view's depth there is within `SEEN` px of disparity). The intersection
would leave out just those pixels whose agreement one of the depths has destroyed, and so hide harm; in the union they
are compared, wherever they are carried to. It is the same set for all depths, and none of them is asked before another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.matching.fuse import transfer
from posegaussian.stages.matching.sampling import disagreement
from posegaussian.stages.network.silhouettes import TOLERANCE, silhouettes_of
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres
from posegaussian.storage.model.masks import foreground

SEEN = 4.0
"""Px of disparity within which two depths are of the same surface."""
PATCH = 7
"""Px, side of the patches that are correlated."""
FLAT = 3.0
"""Standard deviation of a patch's brightness, 1/255, below which it has nothing to correlate."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One frame of all source views: [h, w] arrays by view index."""

    rig: Rig
    color: Mapping[int, np.ndarray]
    """[h, w, 3] uint8."""
    mask: Mapping[int, np.ndarray]
    """[h, w] uint8."""


@dataclass(frozen=True, eq=False)
class Carried:
    """What a pair shows under one depth, on the pixels of its first view."""

    apart: np.ndarray
    """[h, w] px by which the two views' depths disagree, infinite where the point is beside the other's surface; NaN
    without a depth."""
    other: np.ndarray
    """[h, w, 3] float64, the second view's colour at the point."""


def carried(shown: Shown, pair: tuple[int, int], depths: Mapping[int, np.ndarray]) -> Carried:
    """The second view of a pair, as the first sees it under depths [h, w] m by view."""
    rig, (a, b) = shown.rig, pair
    sensitivity = rectify(rig, min(pair), max(pair), look_at_point(rig.subset(list(shown.color)))).sensitivity
    apart = disagreement(depths[a].astype(np.float32), depths[b].astype(np.float32), transfer(rig, a, b), sensitivity)
    x, y = _into(rig, pair, depths[a])
    other = cv2.remap(shown.color[b], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Carried(np.where(depths[a] > 0, apart, np.nan), other.astype(np.float64))


def pair_rows(
    shown: Shown, pair: tuple[int, int], depths: Mapping[str, Mapping[int, np.ndarray]], silhouettes: Silhouettes
) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """A row for every kind of depth, and by kind the colours' differences [h, w], 1/255, NaN beside the union.

    Median and mean of the absolute difference of colours, mean over RGB, after one gain a channel for the pair, which
    is taken where all depths agree; mean ZNCC of patches that are not flat; shares whose depths agree within 1 and 2
    px; and, of the view's whole surface, the share whose points lie outside the silhouette of any other view.
    """
    a = pair[0]
    found = {kind: carried(shown, pair, d) for kind, d in depths.items()}
    union = np.logical_or.reduce([c.apart <= SEEN for c in found.values()])
    both = np.logical_and.reduce([c.apart <= SEEN for c in found.values()])
    own = shown.color[a].astype(np.float64)
    gain = _gain(own, [c.other for c in found.values()], both)
    rows, maps = [], {}
    for kind, c in found.items():
        difference = np.abs(c.other / gain - own).mean(axis=2)
        correlation, told = zncc(own.mean(axis=2), (c.other / gain).mean(axis=2), depths[kind][a] > 0)
        row = {
            "pair": f"{shown.rig.names[a]} -> {shown.rig.names[pair[1]]}",
            "depth": kind,
            "px": int(union.sum()),
            "colour median": _of(np.median, difference[union]),
            "colour mean": _of(np.mean, difference[union]),
        }
        row |= {
            "ZNCC": _of(np.mean, correlation[union & told]),
            "< 1 px": _of(np.mean, c.apart[union] < 1),
            "< 2 px": _of(np.mean, c.apart[union] < 2),
        }
        rows.append({**row, "outside": outside(shown.rig, a, depths[kind][a], silhouettes)})
        maps[kind] = np.where(union, difference, np.nan)
    return rows, maps


def outside(rig: Rig, view: int, depth: np.ndarray, silhouettes: Silhouettes) -> float:
    """Share of a view's surface whose points lie more than `TOLERANCE` px outside the silhouette of any other view
    that sees them."""
    beyond = np.zeros(depth.shape, bool)
    for distance, other in zip(silhouettes.distance, silhouettes.views, strict=True):
        if other != view:
            x, y = _into(rig, (view, other), depth)
            beyond |= (
                cv2.remap(distance, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0) > TOLERANCE
            )
    return _of(np.mean, beyond[depth > 0])


def zncc(first: np.ndarray, second: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zero-mean normalised cross-correlation [h, w], -1..1, of the patches of two brightnesses [h, w], 1/255, over the
    pixels `inside`; and where the first is not flat.

    A second patch that is flat correlates with nothing: 0.
    """
    weight = inside.astype(np.float64)
    count = np.maximum(_sum(weight), 1)
    mean = {n: _sum(weight * p) / count for n, p in (("a", first), ("b", second))}
    variance = {n: np.maximum(_sum(weight * p * p) / count - mean[n] ** 2, 0) for n, p in (("a", first), ("b", second))}
    together = _sum(weight * first * second) / count - mean["a"] * mean["b"]
    # A hundredth of a step: below is rounding.
    scale = np.sqrt(variance["a"] * np.maximum(variance["b"], 1e-4))
    told = inside & (np.sqrt(variance["a"]) > FLAT)
    return np.where(told, np.clip(together / np.where(told, scale, 1), -1, 1), 0), told


def drawn_from(
    shown: Shown, target: int, partners: tuple[int, ...], maps: Mapping[int, tuple[np.ndarray, ...]]
) -> tuple[np.ndarray, np.ndarray]:
    """Colour [h, w, 3] 0..1 premultiplied and alpha [h, w] of a view as the Gaussians of others draw it; `maps` by
    view: depth, scale, normal, opacity."""
    rig = shown.rig
    width, height = (int(n) for n in rig.size[target])
    camera = Camera(rig.intrinsics[target], rig.world_to_camera[target], width, height)
    parts = [
        lift(
            GaussianMaps(shown.color[v], depth, scale, normal, opacity),
            rig.intrinsics[v],
            rig.world_to_camera[v],
            torch.float32,
            torch.device("cpu"),
        ).seen_from(camera)
        for v in partners
        for depth, scale, normal, opacity in [maps[v]]
    ]
    picture = rasterize(type(parts[0]).concatenate(parts), [camera])
    return picture.color[0].numpy(), picture.alpha[0].numpy()


def drawn_row(shown: Shown, target: int, drawn: tuple[np.ndarray, np.ndarray], gained: np.ndarray) -> dict[str, float]:
    """How a drawn view meets its own picture: IoU of silhouettes, and PSNR inside the mask, where `gained` [h, w]
    bool is compared, after a gain a channel."""
    color, alpha = drawn
    height, width = alpha.shape
    mask, own = foreground(shown.mask[target][:height, :width]), shown.color[target][:height, :width].astype(np.float64)
    covered = alpha > 0.5
    straight = 255 * color / np.maximum(alpha, 1e-6)[..., None]
    gain = _gain(own, [straight], mask & covered & gained[:height, :width])
    error = (np.clip(straight / gain, 0, 255) * alpha[..., None] - own)[mask]
    return {
        "IoU": float((mask & covered).sum() / max((mask | covered).sum(), 1)),
        "spill": float((covered & ~mask).sum() / max(mask.sum(), 1)),
        "mask PSNR": float(10 * np.log10(255**2 / max(float((error**2).mean()), 1e-9))),
    }


def table(
    shown: Shown,
    pairs: list[tuple[int, int]],
    depths: Mapping[str, Mapping[int, np.ndarray]],
    maps: Mapping[str, Mapping[int, tuple[np.ndarray, ...]]],
) -> tuple[list[dict[str, Any]], dict[tuple[int, int], dict[str, np.ndarray]]]:
    """Rows by directed pair and kind of depth, and of all pairs together, weighted by their pixels; the differences of
    colours by pair.

    The second view of a pair is also drawn from the first alone.
    """
    silhouettes = silhouettes_of(shown.rig, shown.mask)
    rows: list[dict[str, Any]] = []
    differences = {}
    for pair in pairs:
        found, differences[pair] = pair_rows(shown, pair, depths, silhouettes)
        pictures = {kind: drawn_from(shown, pair[1], pair[:1], maps[kind]) for kind in depths}
        covered = np.logical_and.reduce([alpha > 0.5 for _, alpha in pictures.values()])
        gained = np.zeros(shown.mask[pair[1]].shape, bool)
        gained[: covered.shape[0], : covered.shape[1]] = covered
        rows += [{**row, **drawn_row(shown, pair[1], pictures[row["depth"]], gained)} for row in found]
    for kind in depths:
        own = [r for r in rows if r["depth"] == kind]
        weights = np.array([r["px"] for r in own], float)
        means = {
            k: float(np.average([r[k] for r in own], weights=weights)) if weights.any() else float("nan")
            for k in own[0]
            if k not in ("pair", "depth", "px")
        }
        rows.append({"pair": "all", "depth": kind, "px": int(weights.sum()), **means})
    return rows, differences


def _gain(own: np.ndarray, others: list[np.ndarray], where: np.ndarray) -> np.ndarray:
    """[3] by which the others' medians exceed the view's own; 1 where nothing can be compared."""
    if not where.any():
        return np.ones(3)
    return np.asarray(
        np.median(np.concatenate([o[where] for o in others]), axis=0) / np.maximum(np.median(own[where], axis=0), 1)
    ).clip(0.2, 5)


def _into(rig: Rig, pair: tuple[int, int], depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x, y [h, w] float32 for `cv2.remap`: where the points of the first view's pixels lie in the second; far beside
    it without a depth."""
    first, second = pair
    pixels, z = project(
        unproject(depth, rig.intrinsics[first], rig.world_to_camera[first]),
        rig.intrinsics[second],
        rig.world_to_camera[second],
    )
    known = (depth > 0) & (z > 0)
    x, y = np.moveaxis(np.where(known[..., None], points_to_integer_centres(pixels), -1e4).astype(np.float32), -1, 0)
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


def _sum(values: np.ndarray) -> np.ndarray:
    return np.asarray(
        cv2.boxFilter(values, cv2.CV_64F, (PATCH, PATCH), normalize=False, borderType=cv2.BORDER_CONSTANT)
    )


def _of(mean: Any, values: np.ndarray) -> float:
    return float(mean(values)) if values.size else float("nan")
