"""Backward pass of the projection on the CPU: from gradient slots to gradients of Gaussians and camera.

alpha = 2^-(t² + p² + LIFT) with t = (dx - SLOPE dy) ACROSS, p = dy DOWN, so the moments of alpha dL/dalpha in t and p
that compositing left give the gradients of u, v, SLOPE, ACROSS, DOWN and opacity; the chain rule from there is written
out. Frustum limits are constants: a Gaussian beyond one gets no gradient through the clamped ray, as in the reference.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.splatting.cpu.projection import (
    CAMERA_GRADIENTS,
    COMPENSATED,
    COMPENSATION_MIN,
    D_COLOR,
    D_DEPTH,
    D_NORMAL,
    FX,
    FY,
    LOW_PASS,
    MASS,
    MP,
    MPP,
    MT,
    MTP,
    MTT,
    SCALE,
    SKEW,
    SLOT,
    TWO_LN2,
    W,
    _across_axes,
    _clamped,
    _covariance,
    _cross,
    _dot,
    _in_camera,
    _jacobian,
    _nine,
    _row,
    _scaled,
    _three,
)
from posegaussian.stages.splatting.cpu.simd import (
    WIDTH,
    both,
    choose,
    count,
    fma,
    gather,
    greatest,
    load,
    root,
    scatter,
    some,
    splat,
    spread,
    store,
    store_rows,
)

LARGEST = 1e30
"""A camera's gradient is a sum over BLOCK Gaussians in float32: larger terms are left out and counted."""


@compiled(error_model="numpy")
def gather_slots(bases: Any, slots: Any, first: int, stop: int, total: Any) -> None:
    """Total [8, SLOT] = sums of the gradient slots of up to 8 Gaussians first..stop, in the order of their tiles; 0
    for the others."""
    for i in range(WIDTH):
        low, high = splat(0.0), splat(0.0)
        if first + i < stop:
            for slot in range(bases[first + i], bases[first + i + 1]):
                low, high = low + load(slots, slot * SLOT), high + load(slots, slot * SLOT + WIDTH)
        store(total, i * SLOT, low)
        store(total, i * SLOT + WIDTH, high)


@compiled(error_model="numpy")
def _rotation_row(p: Any, q: Any, w: Any, e0: Any, e1: Any, dn: Any, hit: Any) -> Any:
    """Gradients of a row of the rotation: p and q of J W, w of the camera's rotation."""
    zero = splat(0.0)
    return (
        choose(hit, fma(p, e0[0], q * e1[0]), zero),
        choose(hit, fma(p, e0[1], q * e1[1]), zero),
        choose(hit, fma(p, e0[2], fma(q, e1[2], _dot(w, dn))), zero),
    )


@compiled(error_model="numpy")
def _overflowed(
    to: int, count: int, bad: Any, d_mean: Any, d_rotation: Any, d_scale: Any, d_opacity: Any, d_color: Any
) -> int:
    """Set the gradients of those of the Gaussians to..to + count to 0 that hold a number beyond float32; bad [8]
    gets 1 for them. How many there are."""
    zero = splat(0.0)
    total = load(d_opacity, to) * zero
    for k in range(3):
        total = fma(
            load(d_mean, 3 * to + k * WIDTH),
            zero,
            fma(load(d_scale, 3 * to + k * WIDTH), zero, fma(load(d_color, 3 * to + k * WIDTH), zero, total)),
        )
    for k in range(9):
        total = fma(load(d_rotation, 9 * to + k * WIDTH), zero, total)
    store(bad, 0, zero)
    if not some(total != zero):
        return 0
    found = 0
    for i in range(to, to + count):
        total_of = d_opacity[i]
        for k in range(3):
            total_of += abs(d_mean[3 * i + k]) + abs(d_scale[3 * i + k]) + abs(d_color[3 * i + k])
        for k in range(9):
            total_of += abs(d_rotation[9 * i + k])
        if math.isfinite(total_of):
            continue
        found += 1
        bad[i - to], d_opacity[i] = np.float32(1.0), np.float32(0.0)
        for k in range(3):
            d_mean[3 * i + k] = d_scale[3 * i + k] = d_color[3 * i + k] = np.float32(0.0)
        for k in range(9):
            d_rotation[9 * i + k] = np.float32(0.0)
    return found


@compiled(error_model="numpy")
def project_backward(
    mean: Any, rotation: Any, scale: Any, opacity: Any, view: Any, bases: Any, slots: Any, channels: int, source: int,
    first: int, stop: int,
    d_mean: Any, d_rotation: Any, d_scale: Any, d_opacity: Any, d_color: Any, d_camera: Any,
) -> int:  # fmt: skip
    """Gradients of Gaussians first..stop of the scene, whose attributes start at `source` of the arrays; they are
    written to their own places.

    Groups of eight are read and written whole, so the arrays are padded to a multiple of eight. d_camera
    [CAMERA_GRADIENTS] float64 is added to, so call it with few Gaussians (BLOCK) at a time. Gradients beyond float32
    become 0; returns of how many Gaussians.
    """
    zero, one, two, most = splat(0.0), splat(1.0), splat(2.0), splat(LARGEST)
    total = np.zeros(WIDTH * SLOT, np.float32)
    sum_of = np.zeros(CAMERA_GRADIENTS * WIDTH, np.float32)
    g, bad, dropped = np.zeros(CAMERA_GRADIENTS * WIDTH, np.float32), np.zeros(WIDTH, np.float32), 0
    fx, fy, skew = spread(view, FX), spread(view, FY), spread(view, SKEW)
    w0 = spread(view, W), spread(view, W + 1), spread(view, W + 2)
    w1 = spread(view, W + 3), spread(view, W + 4), spread(view, W + 5)
    w2 = spread(view, W + 6), spread(view, W + 7), spread(view, W + 8)
    for i in range(first, stop, WIDTH):
        at, to, n_valid = source + i - first, i, min(stop - i, WIDTH)
        used = 0
        for k in range(n_valid):
            used += bases[i + k + 1] - bases[i + k]
        if used == 0:
            for k in range(WIDTH * 9):
                d_rotation[9 * to + k] = np.float32(0.0)
            for k in range(WIDTH * 3):
                d_mean[3 * to + k] = d_scale[3 * to + k] = d_color[3 * to + k] = np.float32(0.0)
            for k in range(WIDTH):
                d_opacity[to + k] = np.float32(0.0)
            continue
        gather_slots(bases, slots, i, stop, total)
        mass = gather(total, MASS, SLOT)
        for k in range(WIDTH):
            g[k] = np.float32(bases[i + k + 1] - bases[i + k]) if k < n_valid else np.float32(0.0)
        hit = load(g, 0) > zero
        m, r, s = _three(mean, 3 * at), _nine(rotation, 9 * at), _three(scale, 3 * at)
        x, y, z = _in_camera(view, m)
        zi = one / choose(hit, z, one)
        xz, yz = x * zi, y * zi
        near_x, near_y = _clamped(view, xz, yz)
        j0, j1 = _jacobian(view, near_x, near_y, zi)
        a0, a1 = _across_axes(j0, r), _across_axes(j1, r)
        m0, m1 = _scaled(a0, s), _scaled(a1, s)
        _, b, c, det, sharp, n = _covariance(view, m0, m1)
        c, det = choose(hit, c, one), choose(hit, det, one)
        across = choose(hit, splat(SCALE) * root(c / det), one)
        slope, down = b / c, splat(SCALE) / root(c)
        mt, mp = gather(total, MT, SLOT), gather(total, MP, SLOT)
        k2 = splat(TWO_LN2)
        du = k2 * across * mt
        dv = k2 * (down * mp - slope * across * mt)
        d_slope = k2 * across / down * gather(total, MTP, SLOT)
        d_across = zero - k2 * gather(total, MTT, SLOT) / across
        d_down = zero - k2 * gather(total, MPP, SLOT) / down
        # opacity, and its compensation for the low pass: factor = sqrt(sharp / det)
        on = spread(view, COMPENSATED) > zero
        ratio = root(choose(hit, sharp, one) / det)
        above = both(on, ratio > spread(view, COMPENSATION_MIN))
        factor = choose(on, greatest(ratio, spread(view, COMPENSATION_MIN)), one)
        o = choose(hit, load(opacity, at), one)
        d_shown = mass / (o * factor)
        d_factor = choose(above, d_shown * o, zero)
        store(d_opacity, to, choose(hit, d_shown * factor, zero))
        d_sharp = choose(above, d_factor * factor / (two * choose(sharp > zero, sharp, one)), zero)
        # SLOPE = b / c, ACROSS = SCALE sqrt(c / det), DOWN = SCALE / sqrt(c)
        half = splat(0.5)
        d_det = zero - half * (d_across * across + d_factor * factor) / det
        d_b = d_slope / c
        d_c = (half * (d_across * across - d_down * down) - d_slope * slope) / c
        low = spread(view, LOW_PASS)
        d_a = low * d_det
        d_c = d_c + low * d_det
        d_n = two * (d_det + d_sharp)
        normal = n[0] * d_n, n[1] * d_n, n[2] * d_n
        left, right = _cross(m1, normal), _cross(normal, m0)
        d_m0 = (
            fma(two * d_a, m0[0], fma(d_b, m1[0], left[0])), fma(two * d_a, m0[1], fma(d_b, m1[1], left[1])),
            fma(two * d_a, m0[2], fma(d_b, m1[2], left[2])),
        )  # fmt: skip
        d_m1 = (
            fma(two * d_c, m1[0], fma(d_b, m0[0], right[0])), fma(two * d_c, m1[1], fma(d_b, m0[1], right[1])),
            fma(two * d_c, m1[2], fma(d_b, m0[2], right[2])),
        )  # fmt: skip
        scatter(d_scale, 3 * to, 3, choose(hit, fma(a0[0], d_m0[0], a1[0] * d_m1[0]), zero))
        scatter(d_scale, 3 * to + 1, 3, choose(hit, fma(a0[1], d_m0[1], a1[1] * d_m1[1]), zero))
        scatter(d_scale, 3 * to + 2, 3, choose(hit, fma(a0[2], d_m0[2], a1[2] * d_m1[2]), zero))
        e0, e1 = _scaled(d_m0, s), _scaled(d_m1, s)
        # normals, turned towards the camera
        dn = zero, zero, zero
        if channels > 4:
            seen = _row(view, 0, 3, r, 2), _row(view, 1, 3, r, 2), _row(view, 2, 3, r, 2)
            sign = choose(fma(seen[0], x, fma(seen[1], y, seen[2] * z)) > zero, zero - one, one)
            dn = (
                gather(total, D_NORMAL, SLOT) * sign,
                gather(total, D_NORMAL + 1, SLOT) * sign,
                gather(total, D_NORMAL + 2, SLOT) * sign,
            )
        x0, x1, x2 = _rotation_row(j0[0], j1[0], (w0[0], w1[0], w2[0]), e0, e1, dn, hit)
        y0, y1, y2 = _rotation_row(j0[1], j1[1], (w0[1], w1[1], w2[1]), e0, e1, dn, hit)
        z0, z1, z2 = _rotation_row(j0[2], j1[2], (w0[2], w1[2], w2[2]), e0, e1, dn, hit)
        store_rows(d_rotation, 9 * to, 9, x0, x1, x2, y0, y1, y2, z0, z1)
        scatter(d_rotation, 9 * to + 8, 9, z2)
        # the two rows of J W: dL/dJ0 = R (S dM0)
        d_j0 = (_dot((r[0], r[1], r[2]), e0), _dot((r[3], r[4], r[5]), e0), _dot((r[6], r[7], r[8]), e0))
        d_j1 = (_dot((r[0], r[1], r[2]), e1), _dot((r[3], r[4], r[5]), e1), _dot((r[6], r[7], r[8]), e1))
        p0, p1, p2 = _dot(d_j0, w0) * zi, _dot(d_j0, w1) * zi, _dot(d_j0, w2) * zi
        q1, q2 = _dot(d_j1, w1) * zi, _dot(d_j1, w2) * zi
        d_near_x = zero - fx * p2
        d_near_y = zero - fma(skew, p2, fy * q2)
        d_xz = fma(fx, du, choose(near_x == xz, d_near_x, zero))
        d_yz = fma(skew, du, fma(fy, dv, choose(near_y == yz, d_near_y, zero)))
        d_zi = fma(x, d_xz, fma(y, d_yz, (_dot(d_j0, j0) + _dot(d_j1, j1)) / zi))
        d_x, d_y = choose(hit, d_xz * zi, zero), choose(hit, d_yz * zi, zero)
        d_z = choose(hit, (gather(total, D_DEPTH, SLOT) if channels > 3 else zero) - d_zi * zi * zi, zero)
        scatter(d_mean, 3 * to, 3, fma(w0[0], d_x, fma(w1[0], d_y, w2[0] * d_z)))
        scatter(d_mean, 3 * to + 1, 3, fma(w0[1], d_x, fma(w1[1], d_y, w2[1] * d_z)))
        scatter(d_mean, 3 * to + 2, 3, fma(w0[2], d_x, fma(w1[2], d_y, w2[2] * d_z)))
        scatter(d_color, 3 * to, 3, gather(total, D_COLOR, SLOT))
        scatter(d_color, 3 * to + 1, 3, gather(total, D_COLOR + 1, SLOT))
        scatter(d_color, 3 * to + 2, 3, gather(total, D_COLOR + 2, SLOT))
        # camera
        turn, lowered = fma(fx, near_x, skew * near_y), fy * near_y
        for axis in range(3):
            d0, d1, mm, col = (
                (d_j0[0], d_j1[0], m[0], r[2])
                if axis == 0
                else ((d_j0[1], d_j1[1], m[1], r[5]) if axis == 1 else (d_j0[2], d_j1[2], m[2], r[8]))
            )
            store(g, (0 + axis) * WIDTH, fma(fx * zi, d0, fma(mm, d_x, dn[0] * col)))
            store(g, (3 + axis) * WIDTH, fma(zi, fma(skew, d0, fy * d1), fma(mm, d_y, dn[1] * col)))
            store(g, (6 + axis) * WIDTH, fma(mm, d_z, dn[2] * col) - zi * fma(turn, d0, lowered * d1))
        store(g, 9 * WIDTH, d_x)
        store(g, 10 * WIDTH, d_y)
        store(g, 11 * WIDTH, d_z)
        store(g, 12 * WIDTH, fma(xz, du, p0 - near_x * p2))
        store(g, 13 * WIDTH, fma(yz, du, p1 - near_y * p2))
        store(g, 14 * WIDTH, du)
        store(g, 15 * WIDTH, fma(yz, dv, q1 - near_y * q2))
        store(g, 16 * WIDTH, dv)
        dropped += _overflowed(to, n_valid, bad, d_mean, d_rotation, d_scale, d_opacity, d_color)
        counted = both(hit, load(bad, 0) == zero)
        within = counted
        for k in range(CAMERA_GRADIENTS):
            within = both(within, both(load(g, k * WIDTH) < most, load(g, k * WIDTH) > zero - most))
        dropped += count(counted) - count(within)
        for k in range(CAMERA_GRADIENTS):
            store(sum_of, k * WIDTH, load(sum_of, k * WIDTH) + choose(within, load(g, k * WIDTH), zero))
    for k in range(CAMERA_GRADIENTS):
        for j in range(WIDTH):
            d_camera[k] += np.float64(sum_of[k * WIDTH + j])
    return dropped
