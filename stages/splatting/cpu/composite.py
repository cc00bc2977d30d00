"""Front-to-back compositing of sorted tiles, forward and backward: eight pixels (a block of 4x2) at a time.

A tile's 64 blocks are the bits of one number: those a Gaussian's box reaches, less those in which no pixel lets light
through any more, are visited by counting trailing zeros. The state of a block lies in consecutive cache lines. The
transmittance of a pixel that has stopped is kept with its sign set.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.splatting.cpu.projection import (
    ACROSS,
    BOX_X,
    BOX_Y,
    DOWN,
    LIFT,
    RECORD,
    RED,
    SLOPE,
    SLOT,
    U,
    V,
)
from posegaussian.stages.splatting.cpu.simd import (
    WIDTH,
    all_negative,
    both,
    choose,
    exp2_minus,
    fma,
    least,
    load,
    lowest,
    minus_magnitude,
    prefetch,
    some,
    splat,
    spread,
    store,
    sums,
)
from posegaussian.stages.splatting.cpu.tiles import CENTRE, TILE_X, TILE_Y

BLOCK_X, BLOCK_Y = 4, 2
BLOCKS_X, BLOCKS_Y = TILE_X // BLOCK_X, TILE_Y // BLOCK_Y
BLOCKS = BLOCKS_X * BLOCKS_Y
EVERY = np.uint64(2**BLOCKS - 1)
COLUMN = np.uint64(sum(1 << (BLOCKS_X * row) for row in range(BLOCKS_Y)))
"""The bits of the first column of blocks."""
PLACES = np.array(
    [
        *(BLOCK_X * (b % BLOCKS_X) for b in range(BLOCKS)), *(BLOCK_Y * (b // BLOCKS_X) for b in range(BLOCKS)),
        *(i % BLOCK_X + CENTRE for i in range(WIDTH)), *(i // BLOCK_X + CENTRE for i in range(WIDTH)),
    ],
    np.float32,
)  # fmt: skip
"""Column and row of each block in its tile, then of each pixel's centre in its block, px."""
AHEAD = 8
"""Records fetched ahead, because their order by depth is no order in memory:
without it compositing takes twice as long."""
NEVER = np.float32(3e38)


@compiled(error_model="numpy")
def _reached(bits: Any, r: int, left: int, top: int) -> Any:
    """Blocks of the tile at (left, top) px that the record's box reaches."""
    x, y = bits[r + BOX_X], bits[r + BOX_Y]
    x0, x1 = np.uint64(max((x & 0xFFFF) - left, 0) // BLOCK_X), np.uint64(min((x >> 16) - left, TILE_X - 1) // BLOCK_X)
    y0, y1 = np.uint64(max((y & 0xFFFF) - top, 0) // BLOCK_Y), np.uint64(min((y >> 16) - top, TILE_Y - 1) // BLOCK_Y)
    columns = ((np.uint64(2) << x1) - (np.uint64(1) << x0)) * COLUMN
    return (
        columns
        & (EVERY << (np.uint64(BLOCKS_X) * y0))
        & (EVERY >> (np.uint64(BLOCKS_X) * (np.uint64(BLOCKS_Y - 1) - y1)))
    )


@compiled(error_model="numpy")
def _whitened(records: Any, places: Any, r: int, left: int, top: int) -> Any:
    """(across, -slope across, down, t, p) of a Gaussian: t and p at the pixels of the tile's first block."""
    across, down = spread(records, r + ACROSS), spread(records, r + DOWN)
    lean = splat(0.0) - spread(records, r + SLOPE) * across
    y = load(places, 2 * BLOCKS + WIDTH) - splat(records[r + V] - np.float32(top))
    x = load(places, 2 * BLOCKS) - splat(records[r + U] - np.float32(left))
    return across, lean, down, fma(y, lean, x * across), y * down


@compiled(error_model="numpy")
def _exponent(places: Any, k: int, g: Any, lift: Any) -> Any:
    """(t, p, t² + p² + lift) at the pixels of block k."""
    x, y = spread(places, k), spread(places, BLOCKS + k)
    t, p = fma(x, g[0], fma(y, g[1], g[3])), fma(y, g[2], g[4])
    return t, p, fma(t, t, fma(p, p, lift))


@cache
def forward(channels: int, training: bool) -> Callable[..., None]:
    """The kernel that composites `channels` values a Gaussian, from RED on;
    with `training` it notes where each pixel stopped."""
    state_size = WIDTH * (1 + channels)

    @compiled(error_model="numpy")
    def composite(
        records: Any,
        bits: Any,
        order: Any,
        starts: Any,
        places: Any,
        cuts: Any,
        first: int,
        stop: int,
        across: int,
        width: int,
        height: int,
        picture: Any,
        alpha: Any,
        light: Any,
        ends: Any,
        blended: Any,
    ) -> int:
        """Composite tiles first..stop into picture [h, w, channels] and alpha [h, w]; returns how many blocks were
        blended.

        cuts = (alpha_max, transmittance_stop, reach). With training, light and ends [tiles, blocks, 8] get each pixel's
        last transmittance and the place in the tile's list at which it stopped, and blended [M] the blocks in which a
        Gaussian is seen.
        """
        zero, one, nothing = splat(0.0), splat(1.0), np.uint64(0)
        cap, dark, reach = spread(cuts, 0), spread(cuts, 1), spread(cuts, 2)
        state = np.empty(BLOCKS * state_size + 64, np.float32)
        work = 0
        for tile in range(first, stop):
            a, b = starts[tile], starts[tile + 1]
            if a == b:
                continue
            left, top = tile % across * TILE_X, tile // across * TILE_Y
            for k in range(BLOCKS):
                store(state, k * state_size, one)
                for c in range(channels):
                    store(state, k * state_size + WIDTH * (1 + c), zero)
                if training:
                    store(ends, (tile * BLOCKS + k) * WIDTH, splat(NEVER))
            alive = EVERY
            for j in range(a, b):
                if j + AHEAD < b:
                    prefetch(records, np.int64(order[j + AHEAD]) * RECORD)
                r = np.int64(order[j]) * RECORD
                todo = alive & _reached(bits, r, left, top)
                contributes = nothing
                if todo == nothing:
                    continue
                g, lift = _whitened(records, places, r, left, top), spread(records, r + LIFT)
                here = splat(j - a)
                while todo != nothing:
                    k = lowest(todo)
                    todo &= todo - np.uint64(1)
                    s = k * state_size
                    _, _, e = _exponent(places, k, g, lift)
                    before = load(state, s)
                    weight = choose(e <= reach, least(exp2_minus(e), cap) * before, zero)
                    behind = before - weight
                    seen = behind > dark
                    after = choose(seen, behind, minus_magnitude(before))
                    store(state, s, after)
                    if training:
                        # + zero: a choice of what is there already is made a masked store, 30 cycles on some machines
                        end = (tile * BLOCKS + k) * WIDTH
                        store(ends, end, choose(seen, load(ends, end), least(here, load(ends, end))) + zero)
                    if all_negative(after):
                        alive &= ~(np.uint64(1) << np.uint64(k))
                    weight = choose(seen, weight, zero)
                    if training and some(weight > zero):
                        contributes |= np.uint64(1) << np.uint64(k)
                    for c in range(channels):
                        at = s + WIDTH * (1 + c)
                        store(state, at, fma(weight, spread(records, r + RED + c), load(state, at)))
                    work += 1
                if training:
                    blended[j] = contributes
                if alive == nothing:
                    break
            for k in range(BLOCKS):
                if training:
                    store(light, (tile * BLOCKS + k) * WIDTH, load(state, k * state_size))
                for i in range(WIDTH):
                    x, y = left + k % BLOCKS_X * BLOCK_X + i % BLOCK_X, top + k // BLOCKS_X * BLOCK_Y + i // BLOCK_X
                    if x < width and y < height:
                        alpha[y, x] = np.float32(1.0) - abs(state[k * state_size + i])
                        for c in range(channels):
                            picture[y, x, c] = state[k * state_size + WIDTH * (1 + c) + i]
        return work

    return composite


@cache
def backward(channels: int) -> Callable[..., None]:
    """The backward kernel for `channels` values a Gaussian (3 colours; 4: and depth; 7: and a normal)."""
    state_size = WIDTH * (3 + channels + 1)
    light_at, behind_at, end_at, up_at = 0, WIDTH, 2 * WIDTH, 3 * WIDTH

    @compiled(error_model="numpy")
    def composite_backward(
        records: Any, order: Any, slots: Any, starts: Any, places: Any, cuts: Any, first: int, stop: int, across: int,
        width: int, height: int,
        up_picture: Any, up_alpha: Any, light: Any, ends: Any, blended: Any, gradients: Any,
    ) -> None:  # fmt: skip
        """Fill the gradient slots [M, SLOT] of tiles first..stop, from the gradients of picture and alpha,
        back to front."""
        zero, one, nothing = splat(0.0), splat(1.0), np.uint64(0)
        cap, reach = spread(cuts, 0), spread(cuts, 2)
        state = np.zeros(BLOCKS * state_size + 64, np.float32)
        for tile in range(first, stop):
            a, b = starts[tile], starts[tile + 1]
            if a == b:
                continue
            left, top = tile % across * TILE_X, tile // across * TILE_Y
            for k in range(BLOCKS):
                s, saved = k * state_size, (tile * BLOCKS + k) * WIDTH
                store(state, s + behind_at, zero)
                for i in range(WIDTH):
                    x, y = left + k % BLOCKS_X * BLOCK_X + i % BLOCK_X, top + k // BLOCKS_X * BLOCK_Y + i // BLOCK_X
                    inside = x < width and y < height
                    state[s + light_at + i] = abs(light[saved + i])
                    state[s + end_at + i] = ends[saved + i] if inside else np.float32(0.0)
                    for c in range(channels):
                        state[s + up_at + WIDTH * c + i] = up_picture[y, x, c] if inside else np.float32(0.0)
                    state[s + up_at + WIDTH * channels + i] = up_alpha[y, x] if inside else np.float32(0.0)
            for j in range(b - 1, a - 1, -1):
                if j - AHEAD >= a:
                    prefetch(records, np.int64(order[j - AHEAD]) * RECORD)
                    prefetch(gradients, np.int64(slots[j - AHEAD]) * SLOT)
                    prefetch(gradients, np.int64(slots[j - AHEAD]) * SLOT)
                slot, todo = np.int64(slots[j]) * SLOT, blended[j]
                if todo == nothing:
                    store(gradients, slot, zero)
                    store(gradients, slot + WIDTH, zero)
                    continue
                r = np.int64(order[j]) * RECORD
                g, lift = _whitened(records, places, r, left, top), spread(records, r + LIFT)
                here = splat(j - a)
                mass = mt = mp = mtt = mpp = mtp = zero
                d0 = d1 = d2 = d3 = d4 = d5 = d6 = zero
                while todo != nothing:
                    k = lowest(todo)
                    todo &= todo - np.uint64(1)
                    s = k * state_size
                    t, p, e = _exponent(places, k, g, lift)
                    raw = choose(both(e <= reach, here < load(state, s + end_at)), exp2_minus(e), zero)
                    opacity = least(raw, cap)
                    through = one / (one - opacity)
                    after = load(state, s + light_at)
                    before = after * through
                    weight = opacity * before
                    u = s + up_at
                    value = load(state, u + WIDTH * channels)
                    for c in range(channels):
                        value = fma(load(state, u + WIDTH * c), spread(records, r + RED + c), value)
                    behind = load(state, s + behind_at)
                    slope = through * (after * value - behind)
                    store(state, s + behind_at, fma(weight, value, behind))
                    store(state, s + light_at, before)
                    q = choose(raw < cap, raw * slope, zero)
                    qt, qp = q * t, q * p
                    mass, mt, mp = mass + q, mt + qt, mp + qp
                    mtt, mpp, mtp = fma(qt, t, mtt), fma(qp, p, mpp), fma(qt, p, mtp)
                    d0, d1, d2 = (
                        fma(weight, load(state, u), d0),
                        fma(weight, load(state, u + WIDTH), d1),
                        fma(weight, load(state, u + 2 * WIDTH), d2),
                    )
                    if channels > 3:
                        d3 = fma(weight, load(state, u + 3 * WIDTH), d3)
                    if channels > 4:
                        d4, d5, d6 = (
                            fma(weight, load(state, u + 4 * WIDTH), d4),
                            fma(weight, load(state, u + 5 * WIDTH), d5),
                            fma(weight, load(state, u + 6 * WIDTH), d6),
                        )
                store(gradients, slot, sums(mass, mt, mp, mtt, mpp, mtp, d0, d1))
                store(gradients, slot + WIDTH, sums(d2, d3, d4, d5, d6, zero, zero, zero))

    return composite_backward
