"""What the network is shown: both views of rectified pairs on one grid, with the start of their disparity and what
speaks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.rectification import STRETCH, RectifiedPair, Window
from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.encoders import HEATMAP_CELL
from posegaussian.stages.network.model.quarters import Quarters
from posegaussian.storage.model.cameras import PIXEL_CENTRE, points_to_integer_centres

RELIEF = 16.0
"""Px of disparity that count 1 in what the encoders see of a relief."""
APART = 8.0
"""Px of disagreement between both directions that count 1; twice as many are as bad as it gets."""
MARGIN = 8
"""Px around the subject that the network sees, too."""
EVIDENCE = 5
"""Channels of `evidence`."""
MAPS = ("color", "heatmaps", "start", "confidence", "cover")
"""What `Views` holds a map of for every direction."""


@dataclass(frozen=True, eq=False)
class SourceView:
    """One source view, as the stages before the network made it."""

    color: np.ndarray
    """[h, w, 3] uint8 sRGB."""
    mask: np.ndarray
    """[h, w] uint8."""
    depth: np.ndarray
    """[h, w] float32 metres along the optical axis, 0 where there is no surface."""
    confidence: np.ndarray
    """[h, w] 0..1 of that depth."""
    heatmaps: np.ndarray | None = None
    """[J, h / 4, w / 4] of this frame alone, None where the capture has no joints."""
    stabilised: np.ndarray | None = None
    """[J, h / 4, w / 4] the same, stabilised over time; None where they are not."""


@dataclass(frozen=True, eq=False)
class Third:
    """A further view of each of P pairs, on a window of its own pixels,
    as `posegaussian.stages.network.third_view` cuts it."""

    color: torch.Tensor
    """[P, 3, H, W] sRGB 0..1, premultiplied; the size is its own."""
    heatmaps: torch.Tensor
    """[P, J, H / 4, W / 4]."""
    projection: torch.Tensor
    """[2 P, 3, 4] float64 from the window's pixels of every direction's first view to these, see
    `warping.projection`; zeros: there is no third view."""

    def none(self, pairs: int) -> Third:
        """That of so many pairs without a third view, in the same size."""
        return Third(
            *(
                x.new_zeros(n * pairs, *x.shape[1:])
                for x, n in ((self.color, 1), (self.heatmaps, 1), (self.projection, 2))
            )
        )


@dataclass(frozen=True, eq=False)
class PairViews:
    """A batch of directions of rectified pairs:
    2 i and 2 i + 1 are the two views of pair i, each the other's other view."""

    color: torch.Tensor
    """[B, 3, H, W] sRGB 0..1, premultiplied."""
    heatmaps: torch.Tensor
    """[B, J, H / 4, W / 4] of the frame alone: what is fused into the features, and so moves depth."""
    start: torch.Tensor
    """[B, 1, H, W] px, NaN where there is no surface."""
    confidence: torch.Tensor
    """[B, 1, H, W] 0..1 of the start."""
    cover: torch.Tensor
    """[B, 1, H, W] mask 0..1."""
    coding: Coding
    """Of every direction."""
    third: Third | None = None
    """Of every pair; None where no pair has one."""
    stabilised: torch.Tensor | None = None
    """[B, J, H / 4, W / 4] heatmaps stabilised over time, for the pose encoder alone; None: those of the frame."""
    alone: torch.Tensor | None = None
    """[B] bool, of directions whose other view counts for nothing: a view without a partner. None: no direction."""
    turned: Quarters | None = None
    """Of every direction, by how much its pictures are turned before they are looked at; None: none is."""

    @staticmethod
    def batch(pairs: Sequence[PairViews]) -> PairViews:
        """Several pairs of one size, third views of one size too, as one batch."""
        color, heatmaps, start, confidence, cover = (torch.cat([getattr(p, name) for p in pairs]) for name in MAPS)
        codings = (torch.cat([getattr(p.coding, f.name) for p in pairs]) for f in fields(Coding))
        like = next((p.third for p in pairs if p.third is not None), None)
        third = None
        if like is not None:
            thirds = [like.none(len(p.start) // 2) if p.third is None else p.third for p in pairs]
            third = Third(*(torch.cat([getattr(t, f.name) for t in thirds]) for f in fields(Third)))
        stabilised = torch.cat([p.of_pose for p in pairs]) if any(p.stabilised is not None for p in pairs) else None
        alone = (
            torch.cat([torch.zeros(len(p.start), dtype=torch.bool) if p.alone is None else p.alone for p in pairs])
            if any(p.alone is not None for p in pairs)
            else None
        )
        turned = Quarters(tuple(t for p in pairs for t in p.quarters.turns))
        return PairViews(color, heatmaps, start, confidence, cover, Coding(*codings), third, stabilised, alone, turned)

    def to(self, device: torch.device) -> PairViews:
        """The same on a device; coding and projections stay where they are, their numbers are few."""
        color, heatmaps, start, confidence, cover = (getattr(self, name).to(device) for name in MAPS)
        third = (
            None
            if self.third is None
            else replace(self.third, color=self.third.color.to(device), heatmaps=self.third.heatmaps.to(device))
        )
        stabilised, alone = (None if x is None else x.to(device) for x in (self.stabilised, self.alone))
        return PairViews(color, heatmaps, start, confidence, cover, self.coding, third, stabilised, alone, self.turned)

    @property
    def quarters(self) -> Quarters:
        """By how much the pictures are turned before they are looked at."""
        return Quarters.none(len(self.start)) if self.turned is None else self.turned

    def upright(self) -> PairViews:
        """The same, all maps turned as they are looked at; coding and third view are of the rectified pictures."""
        maps: dict[str, Any] = {name: self.quarters.upright(getattr(self, name)) for name in MAPS}
        stabilised = None if self.stabilised is None else self.quarters.upright(self.stabilised)
        return replace(self, **maps, stabilised=stabilised)

    @property
    def of_pose(self) -> torch.Tensor:
        """[B, J, H / 4, W / 4] what the pose encoder sees."""
        return self.heatmaps if self.stabilised is None else self.stabilised

    @property
    def all_alone(self) -> bool:
        """Whether no direction has another view: then there is nothing to compare, and any number of directions."""
        return self.alone is not None and bool(self.alone.all())

    @property
    def known(self) -> torch.Tensor:
        """[B, 1, H, W] bool, where the start is."""
        return torch.isfinite(self.start)


def others(values: torch.Tensor) -> torch.Tensor:
    """Values [B, ...] of the other view of every direction."""
    return values.reshape(-1, 2, *values.shape[1:]).flip(1).reshape(values.shape)


def rectified_pair(
    pair: RectifiedPair,
    views: tuple[SourceView, SourceView],
    windows: tuple[Window, Window],
    depths: tuple[float, float] | None = None,
    joints: int = 17,
) -> PairViews:
    """Both views of a pair on windows of equal size, multiples of 4 px wide and high and of equal rows.

    depths: nearest and farthest depth, metres, that can come out; None: a tenth beyond those of both starts.
    """
    directions = [(pair, which, windows[which], windows[1 - which]) for which in (0, 1)]
    maps = [_on_window(pair, which, windows[which], windows[1 - which], views[which], joints) for which in (0, 1)]
    near, far = depths or _depths(pair, maps, windows)
    color, heatmaps, start, confidence, cover = (torch.from_numpy(np.stack(m)) for m in zip(*maps, strict=True))
    stabilised = None
    if any(v.stabilised is not None for v in views):
        found = [
            heatmaps_at(v.heatmaps if v.stabilised is None else v.stabilised, _cells(pair, w, windows[w]), joints)
            for w, v in enumerate(views)
        ]
        stabilised = torch.from_numpy(np.stack(found))
    coding = Coding.of(directions, near, far)
    turned = Quarters((pair.quarters,) * 2)
    return PairViews(color, heatmaps, start, confidence, cover, coding, stabilised=stabilised, turned=turned)


def single_view(pair: RectifiedPair, view: SourceView, windows: tuple[Window, Window], joints: int = 17) -> PairViews:
    """The first view of a pair by itself, one direction: its other view counts for nothing."""
    maps = _on_window(pair, 0, *windows, view, joints)
    near, far = _depths(pair, [maps], windows)
    color, heatmaps, start, confidence, cover = (torch.from_numpy(np.ascontiguousarray(m))[None] for m in maps)
    stabilised = (
        None
        if view.stabilised is None
        else torch.from_numpy(heatmaps_at(view.stabilised, _cells(pair, 0, windows[0]), joints))[None]
    )
    coding = Coding.of([(pair, 0, *windows)], near, far)
    alone = torch.ones(1, dtype=torch.bool)
    return PairViews(color, heatmaps, start, confidence, cover, coding, stabilised=stabilised, alone=alone)


def _on_window(
    pair: RectifiedPair, which: int, window: Window, other: Window, view: SourceView, joints: int
) -> tuple[np.ndarray, ...]:
    """Color, heatmaps, start, confidence and cover of one view, channels first, float32."""
    x, y, _ = places(pair, which, window)
    color, cover = colors_at(view, x, y)
    disparity = start_on(pair, which, window, other, view.depth)
    confidence = cv2.remap(view.confidence.astype(np.float32), x, y, cv2.INTER_NEAREST)
    return (
        color,
        heatmaps_at(view.heatmaps, _cells(pair, which, window), joints),
        disparity[None],
        np.where(np.isnan(disparity), 0, confidence)[None],
        cover[None],
    )


def _cells(pair: RectifiedPair, which: int, window: Window) -> np.ndarray:
    """[H / 4, W / 4, 2] source pixels of the centres of a window's heatmap cells."""
    cells = pixel_centres((window[2] // HEATMAP_CELL, window[3] // HEATMAP_CELL)) * HEATMAP_CELL
    return pair.source_pixels(which, cells + np.array(window[:2]))[0]


def colors_at(view: SourceView, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied colour [3, H, W] and cover [H, W] of a view at places x, y [H, W] as `cv2.remap` takes them;
    black beside its picture."""
    cover = cv2.remap(view.mask, x, y, cv2.INTER_LINEAR).astype(np.float32) / 255
    color = cv2.remap(view.color, x, y, cv2.INTER_LINEAR).astype(np.float32) / 255 * cover[..., None]
    return np.moveaxis(color, -1, 0), cover


def heatmaps_at(heatmaps: np.ndarray | None, pixels: np.ndarray, joints: int) -> np.ndarray:
    """[J, H / 4, W / 4] float32 of a view's heatmaps at pixels [H / 4, W / 4, 2] of its own; zeros without joints."""
    if heatmaps is None:
        return np.zeros((joints, *pixels.shape[:2]), np.float32)
    x, y = (
        np.ascontiguousarray(m)
        for m in np.moveaxis(points_to_integer_centres(pixels / HEATMAP_CELL).astype(np.float32), -1, 0)
    )
    return np.stack([cv2.remap(h.astype(np.float32), x, y, cv2.INTER_LINEAR) for h in heatmaps])


@lru_cache(maxsize=8)
def places(pair: RectifiedPair, which: int, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where a window's pixels lie in their source picture: x, y [H, W] float32 for `cv2.remap`, and source depth per
    rectified depth [H, W]."""
    source, ratio = pair.source_pixels(which, pixel_centres(window[2:]) + np.array(window[:2]))
    x, y = (np.ascontiguousarray(m) for m in np.moveaxis(points_to_integer_centres(source).astype(np.float32), -1, 0))
    return x, y, ratio


def start_on(pair: RectifiedPair, which: int, window: Window, other: Window, depth: np.ndarray) -> np.ndarray:
    """Disparity [H, W] float32 between windows, px, of a source depth map [h, w] m at the nearest pixel; NaN where
    that is 0 or beside the picture."""
    x, y, ratio = places(pair, which, window)
    found = cv2.remap(depth, x, y, cv2.INTER_NEAREST)
    known = (found > 0) & (ratio > 0)
    # Of the second view the other one is the first: the same disparity with the other sign.
    sign = 1 if which == 0 else -1
    disparity = sign * pair.disparity(np.where(known, found / np.where(known, ratio, 1), 1)) - (window[0] - other[0])
    return np.where(known, disparity, np.nan).astype(np.float32)


def _depths(
    pair: RectifiedPair, maps: Sequence[tuple[np.ndarray, ...]], windows: tuple[Window, Window]
) -> tuple[float, float]:
    """A tenth before the nearest and behind the farthest depth of the starts, of both views or the first; around the
    subject's distance where there is none."""
    shift = windows[0][0] - windows[1][0]
    found = [pair.depth(s * (m[2] + s * shift)) for s, m in zip((1, -1), maps, strict=False)]
    depths = np.concatenate([d[np.isfinite(d)] for d in found])
    if not depths.size:
        return 0.1, 100.0
    return 0.9 * float(depths.min()), 1.1 * float(depths.max())


def evidence(views: PairViews) -> torch.Tensor:
    """What speaks for the start [B, 5, H, W] float32: whether it is, its confidence, the mask, how much the other
    picture differs at the match (0 of a view without another), and how far the other view's own start disagrees there
    (1: `APART` px; 2 where it has none).
    """
    with torch.no_grad(), torch.autocast(views.start.device.type, enabled=False):
        known = views.known
        apart, disagreement = _contradiction(views)
        return torch.cat(
            [
                known.float(),
                views.confidence.float(),
                views.cover.float(),
                torch.where(known, apart, 0),
                torch.where(known, disagreement, 0),
            ],
            dim=1,
        )


def _contradiction(views: PairViews) -> tuple[torch.Tensor, torch.Tensor]:
    """The last two channels of `evidence` [B, 1, H, W], for every pixel with a start."""
    start = torch.where(views.known, views.start, 0).float()
    nothing = torch.zeros_like(start), torch.full_like(start, 2)
    if views.all_alone:
        return nothing
    back = others(views.start).float()
    found = sampled(torch.cat([others(views.color).float(), others(views.cover).float()], dim=1), start)
    apart = (found[:, :3] - views.color.float()).abs().mean(1, keepdim=True)
    opposite = sampled(torch.where(torch.isfinite(back), back, torch.nan), start, nearest=True)
    disagreement = torch.where(torch.isfinite(opposite), ((start + opposite).abs() / APART).clamp(max=2), 2)
    if views.alone is None:
        return apart, disagreement
    alone = views.alone[:, None, None, None]
    return torch.where(alone, nothing[0], apart), torch.where(alone, nothing[1], disagreement)


def sampled(values: torch.Tensor, disparity: torch.Tensor, nearest: bool = False) -> torch.Tensor:
    """Values [B, C, H, W] of the other view at the match of each pixel under a disparity [B, 1, H, W], px; the rim's
    beyond the rim."""
    batch, _, height, width = disparity.shape
    rows, columns = (torch.arange(n, dtype=torch.float32, device=values.device) + PIXEL_CENTRE for n in (height, width))
    x = columns - disparity[:, 0]
    y = rows[:, None].expand(batch, height, width)
    grid = torch.stack([2 * x / width - 1, 2 * y / height - 1], dim=-1)
    return F.grid_sample(
        values, grid, mode="nearest" if nearest else "bilinear", padding_mode="border", align_corners=False
    )


def relief(disparity: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Disparity [B, 1, H, W] less its mean over the known pixels, in units of `RELIEF` px; 0 elsewhere."""
    weight = known.to(disparity.dtype)
    mean = torch.where(known, disparity, 0).sum((2, 3), keepdim=True) / weight.sum((2, 3), keepdim=True).clamp(min=1)
    return torch.where(known, disparity - mean, 0) / RELIEF


def windows(pair: RectifiedPair, inside: tuple[np.ndarray, np.ndarray], multiple: int) -> tuple[Window, Window] | None:
    """Windows of equal size and rows around what is wanted of both views, [h, w] bool each; None where one of them
    wants nothing.

    Sides are multiples of `multiple` px; a window may reach beyond the rectified frame, where pictures are black.
    """
    first, second = (_box(pair, which, m) for which, m in enumerate(inside))
    if first is None or second is None:
        return None
    top = min(first[1], second[1])
    height = whole_cells(max(first[3], second[3]) - top, multiple)
    width = whole_cells(max(first[2] - first[0], second[2] - second[0]), multiple)
    return (first[0], top, width, height), (second[0], top, width, height)


def too_large(pair: RectifiedPair, window: Window) -> bool:
    """Whether a window holds more than `STRETCH` times the pixels of the larger of the pair's pictures, as large as
    they are looked at: that is no person, and takes memory and minutes that nobody expects."""
    return window[2] * window[3] > STRETCH * pair.scale**2 * float(pair.source_size.prod(axis=1).max())


def window_around(pair: RectifiedPair, inside: np.ndarray, multiple: int) -> Window | None:
    """The window of what is wanted of the first view alone, [h, w] bool, as `windows` has it; None where that is
    nothing."""
    box = _box(pair, 0, inside)
    if box is None:
        return None
    left, top, right, bottom = box
    return left, top, whole_cells(right - left, multiple), whole_cells(bottom - top, multiple)


def _box(pair: RectifiedPair, which: int, inside: np.ndarray) -> tuple[int, int, int, int] | None:
    """Left, top, right and bottom, px of the rectified frame, around what is drawn out by at most `STRETCH` times as
    much as the middle of what is wanted: a blob at the rim of a wide lens has no end there, and of what lies beside
    the window nothing is said."""
    rows, columns = np.nonzero(inside)
    pixels, ratio = pair.rectified_pixels(which, np.stack([columns, rows], axis=-1) + pixel_centres((1, 1))[0, 0])
    pixels, ratio = pixels[ratio > 0], ratio[ratio > 0]
    if not len(pixels):
        return None
    pixels = pixels[STRETCH * ratio**3 >= np.median(ratio) ** 3]
    low, high = np.floor(pixels.min(axis=0) - MARGIN).astype(int), np.ceil(pixels.max(axis=0) + MARGIN).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def whole_cells(length: int, multiple: int) -> int:
    """The least multiple that is at least the length."""
    return -(-length // multiple) * multiple
