"""Front-to-back compositing of sorted tiles in Triton, forward and backward: one program a tile, all its pixels at
once.

A program takes the Gaussians of its list by the chunk, [CHUNK, pixels], and multiplies the transmittance through it by
a scan that starts from what the chunk before has left: the product is the one that a loop over single Gaussians forms,
however long a chunk is. It ends with its list, or when no pixel lets light through any more. What is computed, and
where it stops: stages/splatting/definition/reference.py.

Sizes of pictures are not compiled in (`do_not_specialize`): each that is a multiple of 16, and each that is not, would
be compiled anew, for seconds.
"""

from __future__ import annotations

import triton
import triton.language as tl

from posegaussian.stages.splatting.gpu.projection import ROW
from posegaussian.storage.model.cameras import PIXEL_CENTRE

SLOT = 16
MASS, MP, MQ, MPP, MPQ, MQQ, D_COLOR, D_DEPTH, D_NORMAL = 0, 1, 2, 3, 4, 5, 6, 9, 10
"""Places in a gradient slot: moments of alpha dL/dalpha in the whitened coordinates p and q, and gradients of
colour, depth and normal."""
_ROW, _SLOT, _CENTRE = tl.constexpr(ROW), tl.constexpr(SLOT), tl.constexpr(PIXEL_CENTRE)


@triton.jit
def _pixels(tile, across, width, height, TILE: tl.constexpr):
    """(x, y of the tile's pixel centres, their places in the picture, whether they lie in it), each [TILE^2]."""
    inside = tl.arange(0, TILE * TILE)
    column, row = tile % across * TILE + inside % TILE, tile // across * TILE + inside // TILE
    place = row.to(tl.int64) * width + column
    return column.to(tl.float32) + _CENTRE, row.to(tl.float32) + _CENTRE, place, (column < width) & (row < height)


@triton.jit
def _alphas(row, listed, x, y):
    """(p, q, alpha before the cap), each [CHUNK, pixels], of Gaussians whose rows begin at `row` [CHUNK]. This alpha
    tells what touches a pixel: on a device one that is no number would be the cap after it."""
    u, v = tl.load(row, mask=listed, other=0.0), tl.load(row + 1, mask=listed, other=0.0)
    p0, p1 = tl.load(row + 2, mask=listed, other=0.0), tl.load(row + 3, mask=listed, other=0.0)
    q0, q1 = tl.load(row + 4, mask=listed, other=0.0), tl.load(row + 5, mask=listed, other=0.0)
    opacity = tl.load(row + 6, mask=listed, other=0.0)
    dx, dy = x[None, :] - u[:, None], y[None, :] - v[:, None]
    p, q = p0[:, None] * dx + p1[:, None] * dy, q0[:, None] * dx + q1[:, None] * dy
    return p, q, opacity[:, None] * tl.exp(-0.5 * (p * p + q * q))


@triton.jit
def _payload(row, listed, k):
    """[CHUNK, 1] value k of what is composited: colour, depth, normal."""
    return tl.load(row + (7 + k), mask=listed, other=0.0)[:, None]


@triton.jit(do_not_specialize=["across", "width", "height"])
def composite(
    rows, ids, starts, picture, alpha, light, ends, alpha_min, alpha_max, stop, across, width, height,
    CHANNELS: tl.constexpr, TILE: tl.constexpr, CHUNK: tl.constexpr, TRAINING: tl.constexpr,
):  # fmt: skip
    """Fill one tile of picture [h, w, CHANNELS] and alpha [h, w]; with TRAINING, also of light and ends [h, w].

    light: the transmittance behind the last Gaussian that was blended; ends: one past its place in `ids`, 0 for none.
    """
    tile = tl.program_id(0)
    x, y, place, shown = _pixels(tile, across, width, height, TILE)
    at, last = tl.load(starts + tile), tl.load(starts + tile + 1)
    through = tl.where(shown, 1.0, 0.0)
    cover, r, g, b, z = through * 0.0, through * 0.0, through * 0.0, through * 0.0, through * 0.0
    n0, n1, n2 = through * 0.0, through * 0.0, through * 0.0
    remaining, end = through, tl.zeros([TILE * TILE], tl.int32)
    nearest = (tl.arange(0, CHUNK) == 0)[:, None]
    alive = at < last
    while alive:
        j = at + tl.arange(0, CHUNK)
        listed = j < last
        row = rows + tl.load(ids + j, mask=listed, other=0).to(tl.int64) * _ROW
        _, _, raw = _alphas(row, listed, x, y)
        opacity = tl.minimum(raw, alpha_max)
        touched = listed[:, None] & (raw >= alpha_min)
        opacity = tl.where(touched, opacity, 0.0)
        clear = 1.0 - opacity
        behind = tl.cumprod(tl.where(nearest, through[None, :] * clear, clear), 0)
        seen = behind > stop
        weight = tl.where(seen, behind * (opacity / clear), 0.0)
        cover += tl.sum(weight, 0)
        r += tl.sum(weight * _payload(row, listed, 0), 0)
        g += tl.sum(weight * _payload(row, listed, 1), 0)
        b += tl.sum(weight * _payload(row, listed, 2), 0)
        if CHANNELS > 3:
            z += tl.sum(weight * _payload(row, listed, 3), 0)
        if CHANNELS > 4:
            n0 += tl.sum(weight * _payload(row, listed, 4), 0)
            n1 += tl.sum(weight * _payload(row, listed, 5), 0)
            n2 += tl.sum(weight * _payload(row, listed, 6), 0)
        through = tl.min(behind, 0)  # it never rises: the smallest is the last
        if TRAINING:
            remaining = tl.min(tl.where(seen, behind, remaining[None, :]), 0)
            end = tl.max(tl.where(seen & touched, (j + 1)[:, None], end[None, :]), 0)
        at += CHUNK
        alive = (at < last) & (tl.max(through, 0) > stop)
    tl.store(alpha + place, cover, mask=shown)
    base = picture + place * CHANNELS
    tl.store(base, r, mask=shown)
    tl.store(base + 1, g, mask=shown)
    tl.store(base + 2, b, mask=shown)
    if CHANNELS > 3:
        tl.store(base + 3, z, mask=shown)
    if CHANNELS > 4:
        tl.store(base + 4, n0, mask=shown)
        tl.store(base + 5, n1, mask=shown)
        tl.store(base + 6, n2, mask=shown)
    if TRAINING:
        tl.store(light + place, remaining, mask=shown)
        tl.store(ends + place, end, mask=shown)


@triton.jit(do_not_specialize=["across", "width", "height"])
def composite_backward(
    rows, ids, slots, starts, light, ends, up_picture, up_alpha, gradients, alpha_min, alpha_max, across, width, height,
    CHANNELS: tl.constexpr, TILE: tl.constexpr, CHUNK: tl.constexpr,
):  # fmt: skip
    """Fill the gradient slots [M, SLOT] of one tile's intersections that are seen, back to front;
    the others keep their zeros."""
    tile = tl.program_id(0)
    x, y, place, shown = _pixels(tile, across, width, height, TILE)
    first = tl.load(starts + tile)
    through, end = tl.load(light + place, mask=shown, other=1.0), tl.load(ends + place, mask=shown, other=0)
    base = up_picture + place * CHANNELS
    up_a = tl.load(up_alpha + place, mask=shown, other=0.0)
    up_r, up_g, up_b = (
        tl.load(base, mask=shown, other=0.0),
        tl.load(base + 1, mask=shown, other=0.0),
        tl.load(base + 2, mask=shown, other=0.0),
    )
    up_z, up_0, up_1, up_2 = up_a, up_a, up_a, up_a
    if CHANNELS > 3:
        up_z = tl.load(base + 3, mask=shown, other=0.0)
    if CHANNELS > 4:
        up_0, up_1, up_2 = (
            tl.load(base + 4, mask=shown, other=0.0),
            tl.load(base + 5, mask=shown, other=0.0),
            tl.load(base + 6, mask=shown, other=0.0),
        )
    worth = through * 0.0  # of what lies behind the chunk, as the loss sees it
    nearest, farthest = (tl.arange(0, CHUNK) == 0)[:, None], (tl.arange(0, CHUNK) == CHUNK - 1)[:, None]
    at = tl.max(end, 0)
    while at > first:
        at -= CHUNK
        j = at + tl.arange(0, CHUNK)
        listed = j >= first
        row = rows + tl.load(ids + j, mask=listed, other=0).to(tl.int64) * _ROW
        p, q, raw = _alphas(row, listed, x, y)
        opacity = tl.minimum(raw, alpha_max)
        touched = listed[:, None] & (raw >= alpha_min) & (j[:, None] < end[None, :])
        opacity = tl.where(touched, opacity, 0.0)
        lift = 1.0 / (1.0 - opacity)
        before = tl.cumprod(tl.where(farthest, through[None, :] * lift, lift), 0, reverse=True)
        through = tl.max(before, 0)  # it never falls towards the camera
        weight = opacity * before
        value = (
            up_a[None, :]
            + up_r[None, :] * _payload(row, listed, 0)
            + up_g[None, :] * _payload(row, listed, 1)
            + up_b[None, :] * _payload(row, listed, 2)
        )
        if CHANNELS > 3:
            value += up_z[None, :] * _payload(row, listed, 3)
        if CHANNELS > 4:
            value += (
                up_0[None, :] * _payload(row, listed, 4)
                + up_1[None, :] * _payload(row, listed, 5)
                + up_2[None, :] * _payload(row, listed, 6)
            )
        part = weight * value
        total = tl.cumsum(tl.where(farthest, part + worth[None, :], part), 0, reverse=True)
        worth = tl.sum(tl.where(nearest, total, 0.0), 0)
        # dL/dalpha = T value - sum behind / (1 - alpha)
        m = tl.where(touched & (raw <= alpha_max), raw * (lift * (before * value - total)), 0.0)
        slot = gradients + tl.load(slots + j, mask=listed, other=0).to(tl.int64) * _SLOT
        mp, mq = m * p, m * q
        tl.store(slot, tl.sum(m, 1), mask=listed)
        tl.store(slot + 1, tl.sum(mp, 1), mask=listed)
        tl.store(slot + 2, tl.sum(mq, 1), mask=listed)
        tl.store(slot + 3, tl.sum(mp * p, 1), mask=listed)
        tl.store(slot + 4, tl.sum(mp * q, 1), mask=listed)
        tl.store(slot + 5, tl.sum(mq * q, 1), mask=listed)
        tl.store(slot + 6, tl.sum(weight * up_r[None, :], 1), mask=listed)
        tl.store(slot + 7, tl.sum(weight * up_g[None, :], 1), mask=listed)
        tl.store(slot + 8, tl.sum(weight * up_b[None, :], 1), mask=listed)
        if CHANNELS > 3:
            tl.store(slot + 9, tl.sum(weight * up_z[None, :], 1), mask=listed)
        if CHANNELS > 4:
            tl.store(slot + 10, tl.sum(weight * up_0[None, :], 1), mask=listed)
            tl.store(slot + 11, tl.sum(weight * up_1[None, :], 1), mask=listed)
            tl.store(slot + 12, tl.sum(weight * up_2[None, :], 1), mask=listed)
