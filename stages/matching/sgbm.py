"""Semi-global matching of one rectified pair, along a guide surface and between two bounds.

Before matching, the second picture is warped by the guide's disparity, so that a point on the guide has disparity 0:
matching windows then follow the surface instead of standing upright before it, and only the residual has to be
searched. With the first rectified picture A and the guide's disparity D on its pixels, the warped second picture is
B'(x) = B(x - D(x)). A residual r matches A(x) with B'(x - r) = B(x - r - D(x - r)), so the disparity is r + D(x - r).
"""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.rectification import RectifiedPair, Window
from posegaussian.stages.matching.bounds import Bounds
from posegaussian.stages.matching.sampling import extend, sample
from posegaussian.storage.model.cameras import points_from_integer_centres, points_to_integer_centres

BLOCK = 5
"""Side of the matching window, px; 3 is a little sharper on clean pictures and worse on noisy ones."""
SMOOTH, LEAP = 2, 16
"""Penalties, per window element, of a residual that changes by one and by more (P1 and P2 of OpenCV)."""
GRADIENT_CAP = 15
"""Cap of the horizontal gradient that is compared: what exceeds it is an edge, however strong."""
WIDE, NARROW = cv2.STEREO_SGBM_MODE_HH4, cv2.STEREO_SGBM_MODE_SGBM_3WAY
"""Paths along which costs are added up: four, to and fro, for a wide search; three, from left, right and above, are as
good and quicker where a guide is followed closely. Box PSNR of four scenes, 512 px, mean: 26.73 dB, OpenCV's five from
above 26.55, three for both 26.61, four for both 26.70, eight 26.67."""
MAX_SEARCH = 512
"""Widest residual searched, px."""
SLACK = 1.0
"""Px by which a match may exceed the bounds before it is dropped instead of clamped."""
SLOPE = 10.0
"""Pixel footprints (depth / focal length) of depth between neighbouring pixels,
above which they belong to different surfaces."""
TINY = 1e-3
"""Metres in front of a rectified camera, at least."""
SUBPIXEL = 16
"""OpenCV's fixed-point steps of a pixel."""


def match(
    pair: RectifiedPair,
    first: np.ndarray,
    second: np.ndarray,
    mask: np.ndarray,
    bounds: Bounds,
    paths: int = WIDE,
) -> np.ndarray:
    """Depth [h, w] float32 of the pair's first view, metres along its optical axis, 0 where nothing matches.

    Pixels that the second picture does not show, or shows at an angle at which nothing can be compared, have no match;
    the others do not suffer from it. `first`, `second` [h, w, 3] uint8 are the source pictures, `mask` [h, w] bool says
    which pixels of the first are wanted, `paths` is `WIDE` or `NARROW`. Nothing is checked against the other direction;
    see `posegaussian.stages.matching.fuse`.
    """
    out = np.zeros(mask.shape, np.float32)
    rows, columns = np.nonzero(mask)
    rectified, depth_ratio = pair.rectified_pixels(0, points_from_integer_centres(np.stack([columns, rows], axis=-1)))
    ends = (bounds.near[rows, columns], bounds.far[rows, columns])
    window = _window(rectified[_with_counterpart(pair, rectified, depth_ratio, ends)])
    if window is None:
        return out
    source, ratio = pair.source_pixels(0, pixel_centres(window[2:]) + window[:2])
    guide, near, far = (_disparity(pair, d, source, ratio) for d in (bounds.guide, bounds.near, bounds.far))
    wanted = ~np.isnan(guide) & ~np.isnan(near) & ~np.isnan(far)
    if not wanted.any():
        return out
    guide = extend(guide, wanted)
    low, high = np.where(wanted, np.fmin(near, far), 0), np.where(wanted, np.fmax(near, far), 0)
    smallest, count = _search(low - guide, high - guide, wanted)
    disparity, found = _residual(pair, first, second, window, guide, (smallest, count), paths)
    found &= wanted & (disparity >= low - SLACK) & (disparity <= high + SLACK)
    counterparts = pixel_centres(window[2:]) + window[:2]
    counterparts[..., 0] -= disparity
    found &= pair.seen(1, counterparts)
    depth = pair.depth(np.where(found, np.clip(disparity, low, high), np.nan))
    inverse = np.where(found & (depth > 0), 1 / depth, 0).astype(np.float32)
    xs, ys = np.moveaxis(points_to_integer_centres(rectified) - window[:2], -1, 0)
    back = sample(inverse, np.ascontiguousarray(xs[None]), np.ascontiguousarray(ys[None]), _jump(pair))[0]
    known = (back > 0) & (depth_ratio > 0)
    out[rows[known], columns[known]] = 1 / (back[known] * depth_ratio[known])
    return out


def _with_counterpart(
    pair: RectifiedPair, pixels: np.ndarray, ratio: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """[N] bool: which rectified pixels [N, 2] of the first view, with their ratio of depths [N], may be compared: what
    lies at them, anywhere between the `ends`, near and far depth [N], is not all beside the second picture, nor drawn
    out beyond recognition in either."""
    near, beside = np.zeros(len(pixels), bool), np.ones((4, len(pixels)), bool)
    width, height = pair.source_size[1]
    for depth in ends:
        z = np.maximum(depth * ratio, TINY)
        source, scale = pair.source_pixels(1, np.stack([pixels[:, 0] - pair.disparity(z), pixels[:, 1]], axis=-1))
        near |= (depth > 0) & pair.comparable(1, 1 / np.where(scale > 0, scale, np.inf))
        x, y = source[:, 0], source[:, 1]
        beside &= np.stack([x < 0, y < 0, x > width, y > height])
    return pair.comparable(0, ratio) & near & ~beside.any(axis=0)


def _window(pixels: np.ndarray) -> Window | None:
    """The part of the rectified plane that holds some pixels [N, 2], with a margin of a matching window;
    None for none."""
    if not len(pixels):
        return None
    low, high = np.floor(pixels.min(axis=0)).astype(int) - BLOCK, np.ceil(pixels.max(axis=0)).astype(int) + BLOCK
    w, h = (int(n) for n in high - low)
    return int(low[0]), int(low[1]), w, h


def _disparity(pair: RectifiedPair, depth: np.ndarray, source: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Disparity of a source depth map on rectified pixels, whose source pixels and depth ratio are given;
    NaN = unknown."""
    xs, ys = np.moveaxis(points_to_integer_centres(source), -1, 0)
    sampled = sample(depth, np.ascontiguousarray(xs), np.ascontiguousarray(ys), _jump(pair))
    known = (sampled > 0) & (ratio > 0)
    return np.where(known, pair.disparity(np.where(known, sampled / np.where(known, ratio, 1), 1)), np.nan)


def _jump(pair: RectifiedPair) -> float:
    """Share of the depth by which neighbouring pixels of one surface may differ."""
    return SLOPE * pair.scale / pair.focal


def _search(low: np.ndarray, high: np.ndarray, wanted: np.ndarray) -> tuple[int, int]:
    """Smallest residual and number of residuals (a multiple of 16, as OpenCV wants)
    for all but the widest percent of pixels."""
    smallest = int(np.floor(np.percentile(low[wanted], 1))) - 2
    largest = int(np.ceil(np.percentile(high[wanted], 99))) + 2
    return smallest, min(-(-(largest - smallest + 1) // 16) * 16, MAX_SEARCH)


def _residual(
    pair: RectifiedPair,
    first: np.ndarray,
    second: np.ndarray,
    window: Window,
    guide: np.ndarray,
    search: tuple[int, int],
    paths: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Disparity [h, w] over the window and whether it was found; `search` is the smallest residual, px, and their
    number."""
    (x0, y0, w, h), (smallest, count) = window, search
    first, second = (p[:high, :wide] for p, (wide, high) in zip((first, second), pair.source_size, strict=True))
    # OpenCV leaves out columns whose search would leave the picture, so the picture is made wider by the search.
    left, right = max(smallest + count, 0), max(-smallest, 0)
    wide = (x0 - left, y0, w + left + right, h)
    guide = np.pad(guide, ((0, 0), (left, right)), mode="edge")
    reference = cv2.remap(first, *pair.maps(0, wide), cv2.INTER_CUBIC)
    pixels = pixel_centres(wide[2:]) + wide[:2]
    pixels[..., 0] -= guide
    source, _ = pair.source_pixels(1, pixels)
    xs, ys = np.moveaxis(points_to_integer_centres(source).astype(np.float32), -1, 0)
    warped = cv2.remap(second, np.ascontiguousarray(xs), np.ascontiguousarray(ys), cv2.INTER_CUBIC)
    elements = BLOCK * BLOCK * 3
    matcher = cv2.StereoSGBM.create(
        minDisparity=smallest,
        numDisparities=count,
        blockSize=BLOCK,
        P1=SMOOTH * elements,
        P2=LEAP * elements,
        disp12MaxDiff=-1,
        preFilterCap=GRADIENT_CAP,
        uniquenessRatio=0,
        mode=paths,
    )
    steps = matcher.compute(reference, warped)
    disparity = _along(guide, steps / SUBPIXEL)
    inner = slice(left, left + w)
    return disparity[:, inner], steps[:, inner] >= smallest * SUBPIXEL


@compiled(error_model="numpy")
def _along(guide: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Disparity [h, w] of residuals [h, w] px along the guide's disparity [h, w]: r + D(x - r), D linear between
    pixels and level beyond the first and the last."""
    height, width = guide.shape
    out = np.empty((height, width))
    for i in range(height):
        for j in range(width):
            at = j - residual[i, j]
            column = min(max(int(np.floor(at)), 0), width - 2)
            part = min(max(at - column, 0.0), 1.0)
            out[i, j] = residual[i, j] + (1 - part) * guide[i, column] + part * guide[i, column + 1]
    return out
