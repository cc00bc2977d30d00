"""How bright two source views see the same points of the subject's surface, by the judge's own depth.

Where colours differ between the channels, what a highlight adds to all of them alike takes no part: two cameras are
compared by how far their channels lie from their mean, and gloss of half a stop's difference leaves some hundredths.
Grey surfaces are compared by their light.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from posegaussian.stages.frames.exposures import side_by_side
from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.imaging.color import to_linear
from posegaussian.stages.imaging.exposure import NONE
from posegaussian.stages.judge.memory import Frames
from posegaussian.storage.model.cameras import Rig

POINTS = 64
"""Points told of a pair, each the median of several, the darkest first."""
BLUR = 1.0
"""Px under which pictures are compared: at twice that, half a stop between glossy people was missed by a third more."""
AROUND = 5
"""Px, a square about a point, in which all must be the subject, and nothing clipped."""
SURE = 0.5
"""Least confidence of a depth by which points are found."""
SAME = 0.01
"""Share of the distance within which two views' depths are one surface."""
DARKEST, CLIPPED = 16, 250
"""sRGB values below which a colour is noise, and from which on a pixel may have been brighter."""
COLORFUL = 0.15
"""Least distance of the channels from their mean, over the mean, of a surface that is compared by it."""
FAINTEST = 0.01
"""The same in linear light: below it, it is noise."""
PARALLEL = 0.995
"""Least cosine between the channels' distances from their means in two views: what differs more is not one surface."""
FEWEST = 256
"""Points of a pair, below which it says nothing."""
TONES = 0.7
"""Stops between the medians of the darkest and the brightest third of a grey surface's points: what is brighter at a
single tone may be gloss or haze."""


class _View(NamedTuple):
    """A view's picture of one frame."""

    light: np.ndarray
    """[h, w, 3] linear, blurred."""
    usable: np.ndarray
    """[h, w] bool: amid the subject, neither too dark nor clipped, its depth known."""
    depth: np.ndarray
    """[h, w] m."""


def shared_light(frames: Frames) -> np.ndarray:
    """[V, V, POINTS, 3] float32: stops by which a source view is brighter than each later one at points of the surface
    that both see, as `posegaussian.stages.imaging.exposure.match` takes them; `NONE` where there are none.

    frames: with `frames/color`, `frames/mask`, `depth/depth` and `depth/confidence`.
    """
    rig, sources = frames.rig, frames.views.sources
    out = np.full((len(rig), len(rig), POINTS, 3), NONE, np.float32)
    seen = [{v: _seen(frames, v, f) for v in sources if frames.valid[f, v]} for f in range(len(frames.partition))]
    for a, b in side_by_side(rig, sources):
        light = [_at_shared_points(rig, (a, b), views) for views in seen if a in views and b in views]
        stops = stops_between(*np.concatenate(light, axis=1)) if light else np.zeros((0, 3))
        out[a, b, : len(stops)] = stops
    return out


def _seen(frames: Frames, view: int, f: int) -> _View:
    (width, height), around = (int(n) for n in frames.rig.size[view]), np.ones((AROUND, AROUND), np.uint8)
    color, mask, depth, sure = (
        frames.read(name, view)[f, :height, :width]
        for name in ("frames/color", "frames/mask", "depth/depth", "depth/confidence")
    )
    blurred = cv2.GaussianBlur(color, (0, 0), BLUR)
    amid = cv2.erode((mask == 255).astype(np.uint8), around) > 0
    exposed = (blurred >= DARKEST).all(axis=-1) & (cv2.dilate(color, around) < CLIPPED).all(axis=-1)
    return _View(to_linear(blurred.astype(np.float64)), amid & exposed & (depth > 0) & (sure > SURE), depth)


def _at_shared_points(rig: Rig, pair: tuple[int, int], views: dict[int, _View]) -> np.ndarray:
    """[2, n, 3] linear light of both views at the first one's pixels that the second sees, too."""
    (a, b), (first, second) = pair, (views[v] for v in pair)
    points = unproject(first.depth, rig.intrinsics[a], rig.world_to_camera[a])[first.usable]
    pixels, depth = project(points, rig.intrinsics[b], rig.world_to_camera[b])
    height, width = second.depth.shape
    inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).astype(int).T
    both = inside & second.usable[row, column] & (np.abs(second.depth[row, column] - depth) < SAME * depth)
    return np.stack([first.light[first.usable][both], second.light[row, column][both]])


def stops_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[POINTS or 0, 3] stops by which points [n, 3] of linear light, above 0, are brighter in the first view than in
    the second, the darkest first.

    Of colourful points the stops that all channels share are those of the channels' distance from their mean, and what
    single channels differ by besides is one for all points, the median; where fewer than `FEWEST` are, each is told by
    its light.
    """
    if len(first) < FEWEST:
        return np.zeros((0, 3))
    stops = np.log2(first / second)
    balance = np.median(stops - stops.mean(axis=1, keepdims=True), axis=0)
    away, mean = zip(*(_from_grey(light) for light in (first, second * np.exp2(balance))), strict=True)
    length = [np.linalg.norm(c, axis=1) for c in away]
    same = (away[0] * away[1]).sum(axis=1) > PARALLEL * length[0] * length[1]
    for n, m in zip(length, mean, strict=True):
        same &= (n > FAINTEST) & (n > COLORFUL * m)
    if same.sum() >= FEWEST:
        apart, tone = (np.log2(length[0][same]) + s * np.log2(length[1][same]) for s in (-1, 1))
        return _even(apart[:, None] + balance, tone / 2)
    tone = np.log2(first * second).mean(axis=1) / 2
    dark, bright = (np.median(t) for t in np.array_split(np.sort(tone), 3)[::2])
    return _even(stops, tone) if bright - dark >= TONES else np.zeros((0, 3))


def _from_grey(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the channels from their mean [n, 3], and the mean [n]."""
    mean = light.mean(axis=1)
    return light - mean[:, None], mean


def _even(stops: np.ndarray, tone: np.ndarray) -> np.ndarray:
    """[POINTS, 3] medians of stops [n, 3] over equal parts in the order of tone [n]."""
    order = np.argsort(tone, kind="stable")
    return np.stack([np.median(part, axis=0) for part in np.array_split(stops[order], POINTS)])
