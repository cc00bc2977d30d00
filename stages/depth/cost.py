"""The cost of every offset from a surface, in one fused kernel: warp, correlate, combine the neighbours.

For the offset o, pixel q of the first view is taken to lie at inverse depth g(q) + o, g the guide surface: the window
around a pixel follows the guide, so a slanted surface is not compared as if it faced the camera. What a neighbour shows at
those points is compared with the first picture over the window: zero-mean normalised cross-correlation, all channels together,
and a share for the mean colour. No rectification: a pixel (x, y) at inverse depth r lands on A (x, y, 1) + r b of a neighbour, homogeneous.
"""

from __future__ import annotations

import numpy as np
from numba import njit

WORST = 200
"""Cost of windows that have nothing in common; a perfect match costs 0."""
FORBIDDEN = 255
"""Cost of an offset outside the pixel's bounds."""
COLOR, COLOR_CAP = 0.3, 30.0
"""Share of the score that compares the windows' mean colours, which correlation ignores, and the difference at which it is 0
(1/255): plain cloth has hardly any texture, but ends somewhere."""


@njit(cache=True, nogil=True)
def _warp_row(other: np.ndarray, size: np.ndarray, transfer: np.ndarray, y: int, x0: int, columns: tuple[int, int], mask: np.ndarray, guide: np.ndarray, offset: float, out: np.ndarray, seen: np.ndarray) -> None:
    """One row of a neighbour as the first view would see it: out [channel, w], and whether the point is in the picture, seen [w]."""
    for x in range(columns[0], columns[1]):
        seen[x] = False
        for c in range(out.shape[0]):
            out[c, x] = 0.0
        if not mask[x]:
            continue
        r = guide[x] + offset
        a = transfer[0, 0] * (x + x0) + transfer[0, 1] * y + transfer[0, 2] + r * transfer[0, 3]
        b = transfer[1, 0] * (x + x0) + transfer[1, 1] * y + transfer[1, 2] + r * transfer[1, 3]
        w = transfer[2, 0] * (x + x0) + transfer[2, 1] * y + transfer[2, 2] + r * transfer[2, 3]
        if w <= np.float32(1e-6):
            continue
        inverse = np.float32(1.0) / w
        u, v = a * inverse, b * inverse
        right, bottom = size[0] - np.float32(1.001), size[1] - np.float32(1.001)
        seen[x] = u >= 0 and v >= 0 and u <= size[0] - 1 and v <= size[1] - 1
        u, v = min(max(u, np.float32(0)), right), min(max(v, np.float32(0)), bottom)
        column, row = int(u), int(v)
        s, t = u - np.float32(column), v - np.float32(row)
        for c in range(out.shape[0]):
            top = other[c, row, column] + s * (other[c, row, column + 1] - other[c, row, column])
            low = other[c, row + 1, column] + s * (other[c, row + 1, column + 1] - other[c, row + 1, column])
            out[c, x] = top + t * (low - top)


@njit(cache=True, nogil=True)
def _correlate_row(first: np.ndarray, ring: np.ndarray, y: int, radius: int, columns: tuple[int, int], count: np.ndarray, mean: np.ndarray, spread: np.ndarray, noise: float, color: float, sums: np.ndarray, out: np.ndarray) -> None:
    """How alike the windows around one row are, 0..1: out [w]. `ring` [2 radius + 1, channel, w] holds the warped rows by row modulo its length."""
    height, width = first.shape[1:]
    left, right = max(columns[0] - radius, 0), min(columns[1] + radius, width)
    covariance, variance, apart = sums[3], sums[4], sums[5]
    apart[left:right] = np.float32(0)
    covariance[left:right] = np.float32(0)
    variance[left:right] = np.float32(0)
    for c in range(first.shape[0]):
        for n in range(3):
            sums[n, left:right] = np.float32(0)
        plain, square, product = sums[0], sums[1], sums[2]
        for row in range(max(y - radius, 0), min(y + radius + 1, height)):
            warped, own = ring[row % (2 * radius + 1), c], first[c, row]
            for x in range(left, right):
                plain[x] += warped[x]
                square[x] += warped[x] * warped[x]
                product[x] += own[x] * warped[x]
        for x in range(columns[0], columns[1]):
            a, b, p = np.float32(0), np.float32(0), np.float32(0)
            for near in range(max(x - radius, 0), min(x + radius + 1, width)):
                a += plain[near]
                b += square[near]
                p += product[near]
            covariance[x] += p - mean[c, y, x] * a
            variance[x] += b - a * a * count[y, x]
            apart[x] += (mean[c, y, x] - a * count[y, x]) ** 2
    for x in range(columns[0], columns[1]):
        floor = noise / max(count[y, x], np.float32(1e-6))
        match = covariance[x] / np.sqrt((spread[y, x] + floor) * (max(variance[x], np.float32(0)) + floor))
        like = max(np.float32(0), np.float32(1) - np.sqrt(apart[x]) / color)
        out[x] = np.float32(1 - COLOR) * max(match, np.float32(0)) + np.float32(COLOR) * like


@njit(cache=True, nogil=True)
def _combined(scores: np.ndarray, usable: np.ndarray, x: int, share: float) -> float:
    """Mean of the best `share` of the usable neighbours' correlations at a column, at least one; -1 without any."""
    views = scores.shape[0]
    total = 0
    for k in range(views):
        total += usable[k, x]
    if total == 0:
        return -1.0
    keep = max(int(np.ceil(share * total)), 1)
    mean = 0.0
    last, taken = np.inf, 0
    # Selection by value, then index: `last` is the value taken last, ties are taken together.
    while taken < keep:
        best, ties = -np.inf, 0
        for k in range(views):
            if usable[k, x] and scores[k, x] < last:
                if scores[k, x] > best:
                    best, ties = scores[k, x], 1
                elif scores[k, x] == best:
                    ties += 1
        if ties == 0:
            break
        ties = min(ties, keep - taken)
        mean += ties * best
        taken += ties
        last = best
    return mean / max(taken, 1)


@njit(cache=True, nogil=True)
def cost_volume(
    first: np.ndarray,
    mask: np.ndarray,
    guide: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    offsets: np.ndarray,
    others: np.ndarray,
    sizes: np.ndarray,
    transfers: np.ndarray,
    corner: tuple[int, int],
    radius: int,
    noise: float,
    share: float,
) -> np.ndarray:
    """Cost [h, w, D] uint8 of D offsets of inverse depth at every pixel of a window of the first picture.

    Args:
        first: [channel, h, w] float32, the window of the first picture; its mean should be near 0.
        mask: [h, w] bool, the pixels that are wanted, and that count in a window.
        guide: [h, w] float32, inverse depth of the surface the windows follow, 1/metres.
        low: [h, w] float32, least inverse depth of a pixel.
        high: [h, w] float32, largest inverse depth of a pixel.
        offsets: [D] float32, added to the guide, 1/metres.
        others: [K, channel, H, W] float32, the neighbours' pictures.
        sizes: [K, 2] (width, height) of what of them counts, px.
        transfers: [K, 3, 4] from (x, y, 1, inverse depth) to homogeneous pixels of a neighbour, integer centres in both.
        corner: (x, y) of the window in the first picture.
        radius: half width of the matching window, px.
        noise: variance of the pictures' noise, below which texture does not count; unit of `first` squared.
        share: share of the neighbours that see a point whose scores are averaged, the best of them.

    0 = equal, WORST = uncorrelated and of another colour, or unseen, FORBIDDEN = out of bounds or not wanted.
    """
    channels, height, width = first.shape
    views, depth = others.shape[0], len(offsets)
    volume = np.full((height, width, depth), np.uint8(FORBIDDEN), np.uint8)
    count, mean, spread = _statistics(first, mask, radius)
    spans = np.zeros((height, 2), np.int64)
    for y in range(height):
        spans[y, 0] = width
        for x in range(width):
            if mask[y, x]:
                spans[y, 0], spans[y, 1] = min(spans[y, 0], x), x + 1
    length = 2 * radius + 1
    matrices = transfers.astype(np.float32)
    own = first * mask
    rings = np.zeros((views, length, channels, width), np.float32)
    seen = np.zeros((views, length, width), np.bool_)
    sums, scores = np.zeros((6, width), np.float32), np.zeros((views, width), np.float32)
    usable = np.zeros((views, width), np.bool_)
    for d in range(depth):
        for step in range(height + radius):
            y = step - radius
            for k in range(views):
                if step < height:
                    rings[k, step % length] = np.float32(0)
                    _warp_row(others[k], sizes[k], matrices[k], step + corner[1], corner[0], (spans[step, 0], spans[step, 1]), mask[step], guide[step], offsets[d], rings[k, step % length], seen[k, step % length])
                if y >= 0 and spans[y, 0] < spans[y, 1]:
                    _correlate_row(own, rings[k], y, radius, (spans[y, 0], spans[y, 1]), count, mean, spread, np.float32(noise * channels), np.float32(COLOR_CAP * np.sqrt(channels)), sums, scores[k])
            if y < 0:
                continue
            for x in range(spans[y, 0], spans[y, 1]):
                r = guide[y, x] + offsets[d]
                if not mask[y, x] or r < low[y, x] or r > high[y, x]:
                    continue
                for k in range(views):
                    usable[k, x] = seen[k, y % length, x]
                volume[y, x, d] = np.uint8(np.rint(WORST * (1 - min(max(_combined(scores, usable, x, share), 0.0), 1.0))))
    return volume


@njit(cache=True, nogil=True)
def _statistics(first: np.ndarray, mask: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the window around each pixel: 1 / number of wanted pixels [h, w], mean [channel, h, w], summed squared deviation of all channels [h, w]."""
    channels, height, width = first.shape
    count = np.zeros((height, width), np.float32)
    mean, spread = np.zeros(first.shape, np.float32), np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            if not mask[y, x]:
                continue
            n = 0
            for c in range(channels):
                n, total, square = 0, 0.0, 0.0
                for i in range(max(y - radius, 0), min(y + radius + 1, height)):
                    for j in range(max(x - radius, 0), min(x + radius + 1, width)):
                        if mask[i, j]:
                            n += 1
                            total += first[c, i, j]
                            square += first[c, i, j] ** 2
                mean[c, y, x] = total / n
                spread[y, x] += square - total * total / n
            count[y, x] = 1.0 / n
    return count, mean, spread
