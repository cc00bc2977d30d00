"""EWA projection on the CPU, eight Gaussians at a time, and its backward pass. What is computed:
stages/splatting/definition/projection.py.

Forward writes one record of `RECORD` float32 (a cache line) a Gaussian, in the order of the input; what is culled or
masked gets an empty box and nothing else. With t = (dx - SLOPE dy) ACROSS and p = dy DOWN, alpha = 2^-(t² + p² + LIFT):
the conic completed to squares along the rows of the picture, so no alpha exceeds its opacity by more than rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.splatting.cpu.simd import (
    WIDTH,
    both,
    choose,
    count,
    fma,
    gather,
    greatest,
    least,
    load,
    load_rows,
    log2,
    packed,
    root,
    scatter,
    splat,
    spread,
    store_rows,
)
from posegaussian.stages.splatting.cpu.simd import floor as floor_of
from posegaussian.storage.model.cameras import PIXEL_CENTRE

RECORD = 16
U, V, SLOPE, ACROSS, DOWN, LIFT, RED, DEPTH, NORMAL, OPACITY, BOX_X, BOX_Y = 0, 1, 2, 3, 4, 5, 6, 9, 10, 13, 14, 15
"""Places in a record. BOX_X and BOX_Y are bits: first pixel in the low half, last in the high half."""
REACHES = 3
"""Beside its record, what lists are made of is kept again, close together: BOX_X, BOX_Y and the depth's bits."""
EMPTY = 1
"""A box whose first pixel is 1 and whose last is 0."""
W, T, FX, SKEW, CX, FY, CY, LEFT, RIGHT, TOP, BOTTOM, NEAR = 0, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21
LOW_PASS, VARIANCE_MIN, ALPHA_MIN, REACH, LAST_X, LAST_Y, COMPENSATED, COMPENSATION_MIN = 22, 23, 24, 25, 26, 27, 28, 29
"""Places in a view: camera, frustum limits and cut-offs. REACH = -log2(alpha_min)."""
VIEW = 30
SLOT = 16
MASS, MT, MP, MTT, MPP, MTP, D_COLOR, D_DEPTH, D_NORMAL = 0, 1, 2, 3, 4, 5, 6, 9, 10
"""Places in a gradient slot: moments of alpha dL/dalpha in t and p, and gradients of colour, depth and normal."""
CAMERA_GRADIENTS = 17
"""World to camera rotation (9) and translation (3), fx, skew, cx, fy, cy."""
SCALE = float(np.sqrt(0.5 * np.log2(np.e)))
"""exp(-d²/2) = 2^-(SCALE d)²."""
TWO_LN2 = float(2 * np.log(2))
BLOCK = 4096
"""Gaussians whose camera gradients are summed in float32 before they enter a float64 sum:
fixed, whatever the threads do."""


@compiled(error_model="numpy")
def _row(view: Any, i: int, j: int, r: Any, a: int) -> Any:
    """Product of row i of the world-to-camera rotation with lanes a, a + j,
    a + 2j of a 3x3 set r, which is given by nine lanes."""
    return fma(
        spread(view, W + 3 * i),
        r[a],
        fma(spread(view, W + 3 * i + 1), r[a + j], spread(view, W + 3 * i + 2) * r[a + 2 * j]),
    )


@compiled(error_model="numpy")
def _three(array: Any, at: int) -> Any:
    """Lanes of three consecutive columns of an [N, 3] array."""
    return gather(array, at, 3), gather(array, at + 1, 3), gather(array, at + 2, 3)


@compiled(error_model="numpy")
def _nine(array: Any, at: int) -> Any:
    """Lanes of nine consecutive columns of an [N, 9] array."""
    r = load_rows(array, at, 9)
    return r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], gather(array, at + 8, 9)


@compiled(error_model="numpy")
def _dot(a: Any, b: Any) -> Any:
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@compiled(error_model="numpy")
def _cross(a: Any, b: Any) -> Any:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled(error_model="numpy")
def _in_camera(view: Any, m: Any) -> Any:
    """x, y, z of means in camera axes, metres: products and sums rounded one by one, in the reference's order.

    Both surfaces of two views lie within rounding of each other; a depth that differed in its last bit from the
    reference's would exchange Gaussians, and the picture and its gradient with them.
    """
    return (
        spread(view, W) * m[0] + spread(view, W + 1) * m[1] + spread(view, W + 2) * m[2] + spread(view, T),
        spread(view, W + 3) * m[0] + spread(view, W + 4) * m[1] + spread(view, W + 5) * m[2] + spread(view, T + 1),
        spread(view, W + 6) * m[0] + spread(view, W + 7) * m[1] + spread(view, W + 8) * m[2] + spread(view, T + 2),
    )


@compiled(error_model="numpy")
def _jacobian(view: Any, xz: Any, yz: Any, zi: Any) -> Any:
    """Two rows of J W in the world, px per metre."""
    fx, skew, fy = spread(view, FX), spread(view, SKEW), spread(view, FY)
    turn = fma(fx, xz, skew * yz)
    low = fy * yz
    first = (
        (fma(fx, spread(view, W), skew * spread(view, W + 3)) - turn * spread(view, W + 6)) * zi,
        (fma(fx, spread(view, W + 1), skew * spread(view, W + 4)) - turn * spread(view, W + 7)) * zi,
        (fma(fx, spread(view, W + 2), skew * spread(view, W + 5)) - turn * spread(view, W + 8)) * zi,
    )
    second = (
        (fy * spread(view, W + 3) - low * spread(view, W + 6)) * zi,
        (fy * spread(view, W + 4) - low * spread(view, W + 7)) * zi,
        (fy * spread(view, W + 5) - low * spread(view, W + 8)) * zi,
    )
    return first, second


@compiled(error_model="numpy")
def _across_axes(j: Any, r: Any) -> Any:
    """Row vector times the 3x3 rotation: one component an axis of the Gaussian."""
    return (
        fma(j[0], r[0], fma(j[1], r[3], j[2] * r[6])),
        fma(j[0], r[1], fma(j[1], r[4], j[2] * r[7])),
        fma(j[0], r[2], fma(j[1], r[5], j[2] * r[8])),
    )


@compiled(error_model="numpy")
def _scaled(a: Any, s: Any) -> Any:
    return a[0] * s[0], a[1] * s[1], a[2] * s[2]


@compiled(error_model="numpy")
def _covariance(view: Any, m0: Any, m1: Any) -> Any:
    """(a, b, c, det, det before the low pass, M0 x M1) of the projection, px^2 and px^4."""
    low = spread(view, LOW_PASS)
    a, b, c = _dot(m0, m0), _dot(m0, m1), _dot(m1, m1)
    n = _cross(m0, m1)
    sharp = _dot(n, n)
    return a + low, b, c + low, fma(low, (a + c) + low, sharp), sharp, n


@compiled(error_model="numpy")
def _compensation(view: Any, sharp: Any, det: Any) -> Any:
    """Opacity's factor sqrt(det / det with the low pass), bounded below; 1 where it is off."""
    factor = greatest(root(sharp / det), spread(view, COMPENSATION_MIN))
    return choose(spread(view, COMPENSATED) > splat(0.0), factor, splat(1.0))


@compiled(error_model="numpy")
def _clamped(view: Any, xz: Any, yz: Any) -> Any:
    return least(greatest(xz, spread(view, LEFT)), spread(view, RIGHT)), least(
        greatest(yz, spread(view, TOP)), spread(view, BOTTOM)
    )


@compiled(error_model="numpy")
def _finite(m: Any, r: Any, s: Any, o: Any, c: Any) -> Any:
    """Where every attribute is a finite number: nothing times 0 but what is not finite differs from 0."""
    zero = splat(0.0)
    t = fma(m[0], zero, fma(m[1], zero, fma(m[2], zero, o * zero)))
    t = fma(s[0], zero, fma(s[1], zero, fma(s[2], zero, t)))
    t = fma(c[0], zero, fma(c[1], zero, fma(c[2], zero, t)))
    t = fma(r[0], zero, fma(r[1], zero, fma(r[2], zero, fma(r[3], zero, fma(r[4], zero, t)))))
    t = fma(r[5], zero, fma(r[6], zero, fma(r[7], zero, fma(r[8], zero, t))))
    return t == zero


@compiled(error_model="numpy")
def project(
    mean: Any,
    rotation: Any,
    scale: Any,
    opacity: Any,
    color: Any,
    view: Any,
    records: Any,
    reaches: Any,
    first: int,
    stop: int,
    out: int,
) -> int:
    """Write the records and reaches of Gaussians first..stop (a multiple of 8 of them) from number `out` on; returns
    how many are masked.

    All arrays are flat and contiguous float32. Padding with zeros is finite and has no opacity, so it is not counted.
    """
    masked = 0
    zero, half, huge = splat(0.0), splat(PIXEL_CENTRE), splat(3e38)
    for i in range(first, stop, WIDTH):
        m, r, s, c = _three(mean, 3 * i), _nine(rotation, 9 * i), _three(scale, 3 * i), _three(color, 3 * i)
        o = load(opacity, i)
        finite = _finite(m, r, s, o, c)
        x, y, z = _in_camera(view, m)
        seen = both(both(finite, z > spread(view, NEAR)), o >= spread(view, ALPHA_MIN))
        valid = count(finite)
        zi, xz, yz = splat(1.0) / z, x / z, y / z
        u = spread(view, FX) * xz + spread(view, SKEW) * yz + spread(view, CX)
        v = spread(view, FY) * yz + spread(view, CY)
        near_x, near_y = _clamped(view, xz, yz)
        first_row, second_row = _jacobian(view, near_x, near_y, zi)
        a, b, cc, det, sharp, _ = _covariance(
            view, _scaled(_across_axes(first_row, r), s), _scaled(_across_axes(second_row, r), s)
        )
        thick = det > spread(view, VARIANCE_MIN) * (a + cc)
        o = o * _compensation(view, sharp, choose(thick, det, splat(1.0)))
        lift = splat(0.0) - log2(greatest(o, splat(1e-30)))
        reach = splat(TWO_LN2) * greatest(spread(view, REACH) - lift, zero)
        hx, hy = root(reach * a) + splat(0.01), root(reach * cc) + splat(0.01)
        sane = both(both(det < huge, hx < huge), both(hy < huge, both(u * zero == zero, v * zero == zero)))
        masked += WIDTH - valid + count(seen) - count(both(seen, sane))
        x0, x1 = greatest(zero - floor_of(hx + half - u), zero), least(floor_of(u + hx - half), spread(view, LAST_X))
        y0, y1 = greatest(zero - floor_of(hy + half - v), zero), least(floor_of(v + hy - half), spread(view, LAST_Y))
        keep = both(both(seen, both(sane, thick)), both(both(x0 <= x1, y0 <= y1), o >= spread(view, ALPHA_MIN)))
        box_x = packed(choose(keep, x0, splat(float(EMPTY))), choose(keep, x1, zero))
        box_y = packed(choose(keep, y0, splat(float(EMPTY))), choose(keep, y1, zero))
        down = splat(SCALE) / root(cc)
        n = _row(view, 0, 3, r, 2), _row(view, 1, 3, r, 2), _row(view, 2, 3, r, 2)
        sign = choose(fma(n[0], x, fma(n[1], y, n[2] * z)) > zero, splat(-1.0), splat(1.0))
        at = (out + i - first) * RECORD
        store_rows(records, at, RECORD, u, v, b / cc, splat(SCALE) * root(cc / det), down, lift, c[0], c[1])
        scatter(reaches, (out + i - first) * REACHES, REACHES, box_x)
        scatter(reaches, (out + i - first) * REACHES + 1, REACHES, box_y)
        scatter(reaches, (out + i - first) * REACHES + 2, REACHES, z)
        store_rows(records, at + 8, RECORD, c[2], z, n[0] * sign, n[1] * sign, n[2] * sign, o, box_x, box_y)
    return masked
