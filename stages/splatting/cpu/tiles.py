"""Which Gaussian reaches which tile, nearest first: counting, filling, and a radix sort of every tile's list.

An intersection of a Gaussian with a tile has a slot: slots are numbered by Gaussian, so that what the backward pass
leaves in them is summed in one fixed order. A tile's list holds (bits of the depth, slot) in one 64-bit number;
positive floats sort like their bits, and the sort is stable, so equal depths are blended in the order of the input.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.splatting.cpu.projection import ACROSS, DOWN, LIFT, REACHES, RECORD, SLOPE, U, V
from posegaussian.storage.model.cameras import PIXEL_CENTRE

TILE_X, TILE_Y = 32, 16
"""Pixels of a tile: 64 blocks of 4x2, one bit each. 16x16 has 14 % more intersections and is as much slower."""
EXACT = 3
"""From this many tiles across or down, the ellipse decides which tiles of the box are reached."""
CENTRE, SLACK = PIXEL_CENTRE, 0.01
"""px: the centre of pixel 0, and more than float32 rounding at 8k px."""
NARROW, WIDE, LONG = 8, 11, 256
"""Bits of a digit of the depth, and of lists of `LONG` or more, which take a round less by them: clearing and summing
the histograms must not outweigh the list."""
BINS = max(-(-32 // bits) << bits for bits in (NARROW, WIDE))
"""Of all digits of a depth together."""


@compiled(error_model="numpy")
def _columns(records: Any, r: int, row: int, x0: int, x1: int, reach: float) -> tuple[int, int]:
    """First and last tile of a row of tiles that the ellipse inside which alpha >= alpha_min reaches (last < first:
    none).

    The ellipse's width over the band of rows is largest at its own rightmost (leftmost) point, or on the band's edge
    nearest to it.
    """
    low = row * TILE_Y + CENTRE - records[r + V]
    high = low + (TILE_Y - 1)
    slope, across, down = float(records[r + SLOPE]), float(records[r + ACROSS]), float(records[r + DOWN])
    k = reach - records[r + LIFT]
    tip = math.sqrt(k / (down * down * (1.0 + slope * slope * across * across / (down * down)))) * slope * across / down
    right_y, left_y = min(max(tip, low), high), min(max(-tip, low), high)
    right = slope * right_y + math.sqrt(max(k - down * down * right_y * right_y, 0.0)) / across
    left = slope * left_y - math.sqrt(max(k - down * down * left_y * left_y, 0.0)) / across
    nearest = min(max(0.0, low), high)
    if down * down * nearest * nearest > k * 1.0001 + 1e-3:
        return 1, 0
    first = math.ceil(records[r + U] + left - CENTRE - SLACK) // TILE_X
    last = math.floor(records[r + U] + right - CENTRE + SLACK) // TILE_X
    return max(first, x0), min(last, x1)


@compiled(error_model="numpy")
def _box(reaches: Any, i: int) -> tuple[int, int, int, int]:
    """Tiles (first column, last column, first row, last row) of a Gaussian's box."""
    x, y = reaches[REACHES * i], reaches[REACHES * i + 1]
    return (x & 0xFFFF) // TILE_X, (x >> 16) // TILE_X, (y & 0xFFFF) // TILE_Y, (y >> 16) // TILE_Y


@compiled(error_model="numpy")
def count_tiles(records: Any, reaches: Any, across: int, reach: float, counts: Any, bases: Any) -> int:
    """Fill counts [tiles] with the intersections of each tile and bases [N + 1] with each Gaussian's first slot;
    returns their number."""
    total = 0
    counts[:] = 0
    for i in range(len(bases) - 1):
        bases[i] = total
        if (reaches[REACHES * i] & 0xFFFF) > (reaches[REACHES * i] >> 16):
            continue
        x0, x1, y0, y1 = _box(reaches, i)
        exact = x1 - x0 >= EXACT or y1 - y0 >= EXACT
        for row in range(y0, y1 + 1):
            first, last = _columns(records, i * RECORD, row, x0, x1, reach) if exact else (x0, x1)
            for column in range(first, last + 1):
                counts[row * across + column] += 1
            total += max(last - first + 1, 0)
    bases[len(bases) - 1] = total
    return total


@compiled(error_model="numpy", forceinline=True)
def _fill(
    records: Any, reaches: Any, across: int, reach: float, cursors: Any, entries: Any, owners: Any, slotted: bool
) -> None:
    """As `fill_tiles`, compiled for lists of slots and of Gaussians."""
    slot = 0
    for i in range(len(records) // RECORD):
        if (reaches[REACHES * i] & 0xFFFF) > (reaches[REACHES * i] >> 16):
            continue
        x0, x1, y0, y1 = _box(reaches, i)
        key = np.uint64(reaches[REACHES * i + 2]) << np.uint64(32)
        exact = x1 - x0 >= EXACT or y1 - y0 >= EXACT
        for row in range(y0, y1 + 1):
            first, last = _columns(records, i * RECORD, row, x0, x1, reach) if exact else (x0, x1)
            for column in range(first, last + 1):
                tile = row * across + column
                entries[cursors[tile]] = key | np.uint64(slot if slotted else i)
                cursors[tile] += 1
                if slotted:
                    owners[slot] = i
                    slot += 1


@compiled(error_model="numpy")
def fill_tiles(records: Any, reaches: Any, across: int, reach: float, cursors: Any, entries: Any, owners: Any) -> None:
    """Write (depth bits, slot) into the tiles' lists in entries [M], from cursors [tiles] on, and each slot's
    Gaussian into owners [M]; with no owners (depth bits, Gaussian), which sort alike."""
    if len(owners) > 0:
        _fill(records, reaches, across, reach, cursors, entries, owners, True)
    else:
        _fill(records, reaches, across, reach, cursors, entries, owners, False)


@compiled(error_model="numpy", forceinline=True)
def _sorted(entry: Any, scratch: Any, histogram: Any, radix: int) -> Any:
    """Entries by depth, in `entry` itself or in `scratch`: digits of `radix` bits of the depths' bits less their
    smallest, least significant first, counted in one pass. Compiled for each radix: it is written out in the calls."""
    n, digits, most = len(entry), 1 << radix, np.uint64((1 << radix) - 1)
    low, high = np.uint64(2**64 - 1), np.uint64(0)
    for j in range(n):
        low, high = min(low, entry[j]), max(high, entry[j])
    base, rounds = low >> np.uint64(32), 0
    if n > 1:
        span = (high >> np.uint64(32)) - base
        while span >> np.uint64(radix * rounds):
            rounds += 1
    histogram[: digits * rounds] = 0
    if rounds > 0:
        for j in range(n):
            key = (entry[j] >> np.uint64(32)) - base
            for d in range(rounds):
                histogram[np.uint64(d * digits) + ((key >> np.uint64(radix * d)) & most)] += np.uint32(1)
    source, target = entry, scratch
    for d in range(rounds):
        total, at = np.uint32(0), d * digits
        for k in range(at, at + digits):
            total, histogram[k] = total + histogram[k], total
        for j in range(n):
            k = np.uint64(at) + ((((source[j] >> np.uint64(32)) - base) >> np.uint64(radix * d)) & most)
            target[histogram[k]] = source[j]
            histogram[k] += np.uint32(1)
        source, target = target, source
    return source


@compiled(error_model="numpy")
def sort_tiles(
    starts: Any, first: int, stop: int, entries: Any, scratch: Any, owners: Any, order: Any, slots: Any
) -> None:
    """Sort the lists of tiles first..stop by depth; order [M] gets the Gaussians and slots [M] the slots, none without
    owners. scratch is as long as the longest list."""
    histogram, slotted = np.empty(BINS, np.uint32), len(owners) > 0
    for tile in range(first, stop):
        a, n = starts[tile], starts[tile + 1] - starts[tile]
        entry = entries[a : a + n]
        done = _sorted(entry, scratch, histogram, WIDE) if n >= LONG else _sorted(entry, scratch, histogram, NARROW)
        for j in range(n):
            number = done[j] & np.uint64(0xFFFFFFFF)
            if slotted:
                slots[a + j] = number
            order[a + j] = owners[number] if slotted else number
