"""The cost of every offset from a surface, in one fused kernel: warp, correlate, combine the neighbours.

For the offset o, pixel q of the first view is taken to lie at inverse depth g(q) + o, g the guide surface: the window
around a pixel follows the guide, so a slanted surface is not compared as if it faced the camera. What a neighbour shows
at those points is compared with the first picture over the window: zero-mean normalised cross-correlation, all channels
together, and a share for the mean colour. No rectification: a pixel (x, y) at inverse depth r lands on A (x, y, 1) + r
b of a neighbour, homogeneous.

Speed comes from loops a compiler can turn into vector instructions: one row at a time, arrays cut to length beforehand,
single precision, no branch; and from rows that are cut to where an offset is within the bounds at all.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled

WORST = 200
"""Cost of windows that have nothing in common; a perfect match costs 0."""
FORBIDDEN = 255
"""Cost of an offset outside the pixel's bounds."""
COLOR, COLOR_CAP = 0.3, 30.0
"""Share of the score that compares the windows' mean colours, which correlation ignores, and the difference at which
it is 0 (1/255): plain cloth has hardly any texture, but ends somewhere."""
F = np.float32


@compiled
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
        transfers: [K, 3, 4] from (x, y, 1, inverse depth) to homogeneous pixels of a neighbour, integer centres in
            both.
        corner: (x, y) of the window in the first picture.
        radius: half width of the matching window, px.
        noise: variance of the pictures' noise, below which texture does not count; unit of `first` squared.
        share: share of the neighbours that see a point whose scores are averaged, the best of them.

    0 = equal, WORST = uncorrelated and of another colour, or unseen, FORBIDDEN = out of bounds or not wanted.
    """
    channels, height, width = first.shape
    views, depth, length = others.shape[0], len(offsets), 2 * radius + 1
    volume = np.full((height, width, depth), np.uint8(FORBIDDEN), np.uint8)
    own = np.zeros((channels, height, width + 2 * radius), F)
    own[:, :, radius : radius + width] = first * mask
    window = _statistics(own, mask, radius, F(noise * channels))
    weight = mask.astype(F)
    keep = np.array([max(np.ceil(share * n), 1.0) for n in range(views + 1)], F)
    warped, places = np.zeros((channels, width + 2 * radius), F), np.zeros((2, width + 2 * radius), F)
    rings, seen = np.zeros((views, length, 3, channels, width), F), np.zeros((views, length, width), F)
    sums, scores, costs = np.zeros((6, width), F), np.zeros((views + 2, width), F), np.zeros(width, np.uint8)
    spans, wide = np.zeros((height, 2), np.int64), np.zeros((height + 2 * radius, 2), np.int64)
    for d in range(depth):
        _spans(mask, guide, low, high, offsets[d], spans)
        _widened(spans, radius, wide)
        for step in range(height + radius):
            y, slot = step - radius, step % length
            start, end = wide[step]
            for k in range(views):
                if step >= height:
                    rings[k, slot] = F(0)
                elif start < end:
                    _warp_row(
                        others[k],
                        sizes[k],
                        transfers[k],
                        (corner[0], step + corner[1]),
                        (start, end),
                        weight[step],
                        guide[step],
                        offsets[d],
                        radius,
                        places,
                        warped,
                        seen[k, slot],
                    )
                    _sum_row(own, step, warped, (start, end), radius, places, rings[k, slot])
            if y < 0 or spans[y, 0] >= spans[y, 1]:
                continue
            for k in range(views):
                _score_row(
                    rings[k],
                    window,
                    y,
                    (spans[y, 0], spans[y, 1]),
                    min(y, radius) + 1 + radius,
                    slot,
                    F(COLOR_CAP * np.sqrt(channels)),
                    seen[k, y % length],
                    sums,
                    scores[k],
                )
            _combine(scores, seen, y % length, (spans[y, 0], spans[y, 1]), keep, costs)
            _put(costs, mask[y], guide[y], low[y], high[y], offsets[d], (spans[y, 0], spans[y, 1]), volume[y, :, d])
    return volume


@compiled
def _statistics(own: np.ndarray, mask: np.ndarray, radius: int, noise: np.float32) -> np.ndarray:
    """[3 + channel, h, w] of the window around each wanted pixel: 1 / number of wanted pixels, the noise in all of
    them, 1 / root of the summed squared deviation of all channels and the noise, and the mean of each channel."""
    channels, (height, width) = own.shape[0], mask.shape
    out = np.zeros((3 + channels, height, width), np.float32)
    for y in range(height):
        for x in range(width):
            if not mask[y, x]:
                continue
            spread, n = 0.0, 0
            for c in range(channels):
                n, total, square = 0, 0.0, 0.0
                for i in range(max(y - radius, 0), min(y + radius + 1, height)):
                    for j in range(max(x - radius, 0), min(x + radius + 1, width)):
                        n += mask[i, j]
                        total += own[c, i, j + radius]
                        square += own[c, i, j + radius] ** 2
                out[3 + c, y, x] = total / n
                spread += square - total * total / n
            out[0, y, x], out[1, y, x], out[2, y, x] = 1.0 / n, noise * n, 1.0 / np.sqrt(max(spread, 0.0) + noise * n)
    return out


@compiled
def _spans(
    mask: np.ndarray, guide: np.ndarray, low: np.ndarray, high: np.ndarray, offset: float, spans: np.ndarray
) -> None:
    """Fill spans [h, 2] with the columns from the first to behind the last pixel of each row whose bounds hold the
    offset; (w, 0) where none."""
    height, width = mask.shape
    for y in range(height):
        a, b = 0, width
        while a < width and not (mask[y, a] and low[y, a] <= guide[y, a] + offset <= high[y, a]):
            a += 1
        while b > a and not (mask[y, b - 1] and low[y, b - 1] <= guide[y, b - 1] + offset <= high[y, b - 1]):
            b -= 1
        spans[y] = (a, b) if a < b else (width, 0)


@compiled
def _widened(spans: np.ndarray, radius: int, wide: np.ndarray) -> None:
    """Fill wide [>= h, 2] with the columns of each row that windows in rows up to `radius` away are summed at."""
    height = spans.shape[0]
    for y in range(height):
        wide[y] = spans[y]
        for i in range(max(y - radius, 0), min(y + radius + 1, height)):
            wide[y, 0], wide[y, 1] = min(wide[y, 0], spans[i, 0]), max(wide[y, 1], spans[i, 1])


@compiled(error_model="numpy")
def _warp_row(
    other: np.ndarray,
    size: np.ndarray,
    transfer: np.ndarray,
    at: tuple[int, int],
    span: tuple[int, int],
    weight: np.ndarray,
    guide: np.ndarray,
    offset: float,
    radius: int,
    places: np.ndarray,
    warped: np.ndarray,
    seen: np.ndarray,
) -> None:
    """One row of a neighbour as the first view would see it, and whether each point is in its picture, seen [w] 0 or 1.

    `warped` [channel, w + 2 radius] holds column x at x + radius, 0 where the weight is and beside the row. `at` is (x,
    y) of the row's first pixel in the first picture.
    """
    start, end = max(span[0] - radius, 0), min(span[1] + radius, len(guide))
    n, wide = end - start, other.shape[2]
    base, slope, along = np.empty(3, F), np.empty(3, F), np.empty(3, F)
    for i in range(3):
        base[i] = transfer[i, 0] * (at[0] + start) + transfer[i, 1] * at[1] + transfer[i, 2]
        slope[i], along[i] = transfer[i, 0], transfer[i, 3]
    a0, b0, w0, a1, b1, w1, a2, b2, w2 = (
        base[0],
        base[1],
        base[2],
        slope[0],
        slope[1],
        slope[2],
        along[0],
        along[1],
        along[2],
    )
    right, bottom = F(size[0] - 1), F(size[1] - 1)
    surface, inside, us, vs = guide[start:end], seen[start:end], places[0, :n], places[1, :n]
    for i in range(n):
        x, r = F(np.int32(i)), surface[i] + offset
        w = w0 + x * w1 + r * w2
        inverse = F(1) / max(w, F(1e-6))
        u, v = (a0 + x * a1 + r * a2) * inverse, (b0 + x * b1 + r * b2) * inverse
        inside[i] = F(1) if (w > F(1e-6)) & (u >= F(0)) & (v >= F(0)) & (u <= right) & (v <= bottom) else F(0)
        us[i], vs[i] = min(max(u, F(0)), right - F(0.001)), min(max(v, F(0)), bottom - F(0.001))
    for c in range(other.shape[0]):
        flat, row, here = other[c].ravel(), warped[c, start + radius : end + radius], weight[start:end]
        for i in range(n):
            column, line = np.int32(us[i]), np.int32(vs[i])
            s, t = us[i] - F(column), vs[i] - F(line)
            p = np.int64(line) * wide + column
            top = flat[p] + s * (flat[p + 1] - flat[p])
            low = flat[p + wide] + s * (flat[p + wide + 1] - flat[p + wide])
            row[i] = (top + t * (low - top)) * here[i]


@compiled
def _add(total: np.ndarray, values: np.ndarray) -> None:
    """One array [n] to another."""
    for i in range(len(total)):
        total[i] += values[i]


@compiled
def _sum_row(
    own: np.ndarray,
    y: int,
    warped: np.ndarray,
    span: tuple[int, int],
    radius: int,
    products: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill out [3, channel, w] with sums over 2 radius + 1 columns of a warped row, its square and its product with
    row y of own [channel, h, w + 2 radius]."""
    start, end = span
    out[:, :, start:end] = F(0)
    for c in range(own.shape[0]):
        other, mine, square, product = (
            warped[c, start : end + 2 * radius],
            own[c, y, start : end + 2 * radius],
            products[0, start : end + 2 * radius],
            products[1, start : end + 2 * radius],
        )
        for i in range(len(other)):
            square[i] = other[i] * other[i]
            product[i] = other[i] * mine[i]
        for shift in range(2 * radius + 1):
            _add(out[0, c, start:end], warped[c, start + shift : end + shift])
            _add(out[1, c, start:end], products[0, start + shift : end + shift])
            _add(out[2, c, start:end], products[1, start + shift : end + shift])


@compiled(error_model="numpy")
def _score_row(
    ring: np.ndarray,
    window: np.ndarray,
    y: int,
    span: tuple[int, int],
    rows: int,
    last: int,
    color: np.float32,
    seen: np.ndarray,
    sums: np.ndarray,
    out: np.ndarray,
) -> None:
    """How alike the windows around row y are, 0..1, -1 where unseen: out [w].

    `ring` [2 radius + 1, 3, channel, w] holds the sums of the last rows, of which `rows` up to the slot `last` belong
    to the windows.
    """
    start, end = span
    sums[:, start:end] = F(0)
    covariance, variance, apart = sums[3, start:end], sums[4, start:end], sums[5, start:end]
    count, floor, spread = window[0, y, start:end], window[1, y, start:end], window[2, y, start:end]
    for c in range(ring.shape[2]):
        plain, square, product, mean = (
            sums[0, start:end],
            sums[1, start:end],
            sums[2, start:end],
            window[3 + c, y, start:end],
        )
        sums[:3, start:end] = F(0)
        for back in range(rows):
            slot = (last - back) % ring.shape[0]
            _add(plain, ring[slot, 0, c, start:end])
            _add(square, ring[slot, 1, c, start:end])
            _add(product, ring[slot, 2, c, start:end])
        for i in range(len(plain)):
            covariance[i] += product[i] - mean[i] * plain[i]
        for i in range(len(plain)):
            variance[i] += square[i] - plain[i] * plain[i] * count[i]
        for i in range(len(plain)):
            apart[i] += (mean[i] - plain[i] * count[i]) * (mean[i] - plain[i] * count[i])
    visible, score = seen[start:end], out[start:end]
    for i in range(len(score)):
        match = covariance[i] * spread[i] / np.sqrt(max(variance[i], F(0)) + floor[i])
        score[i] = F(1 - COLOR) * max(match, F(0))
    for i in range(len(score)):
        found = score[i] + F(COLOR) * max(F(0), F(1) - np.sqrt(apart[i]) / color)
        score[i] = found if visible[i] > F(0) else F(-1)


@compiled(error_model="numpy")
def _combine(
    scores: np.ndarray, seen: np.ndarray, slot: int, span: tuple[int, int], keep: np.ndarray, costs: np.ndarray
) -> None:
    """Costs [w] uint8 of the mean of the best of K neighbours' scores [K + 2, w], whose last two rows are scratch.

    Of n neighbours that see a point in `seen` [K, slots, w], keep[n] count.
    """
    start, end = span
    views = seen.shape[0]
    for k in range(views - 1):
        for j in range(views - 1 - k):
            a, b = scores[j, start:end], scores[j + 1, start:end]
            for i in range(len(a)):
                better, worse = max(a[i], b[i]), min(a[i], b[i])
                a[i], b[i] = better, worse
    taken, mean, cost = scores[views, start:end], scores[views + 1, start:end], costs[start:end]
    taken[:], mean[:] = F(0), F(0)
    for k in range(views):
        _add(taken, seen[k, slot, start:end])
    for i in range(len(taken)):
        taken[i] = keep[np.int32(taken[i])]
    for k in range(views):
        score, nth = scores[k, start:end], F(k)
        for i in range(len(mean)):
            mean[i] += score[i] if nth < taken[i] else F(0)
    for i in range(len(cost)):
        cost[i] = np.uint8(np.rint(F(WORST) * (F(1) - min(max(mean[i] / taken[i], F(0)), F(1)))))


@compiled
def _put(
    costs: np.ndarray,
    mask: np.ndarray,
    guide: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    offset: float,
    span: tuple[int, int],
    out: np.ndarray,
) -> None:
    """Out [w] takes the costs of the wanted pixels whose bounds hold the offset."""
    for x in range(span[0], span[1]):
        r = guide[x] + offset
        if mask[x] and low[x] <= r <= high[x]:
            out[x] = costs[x]
