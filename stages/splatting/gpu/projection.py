"""EWA projection in Triton, one Gaussian a lane. What is computed: stages/splatting/definition/projection.py.

A Gaussian gets its row, as compositing reads it, the box of the tiles that it can reach, and its depth as a whole
number, which sorts alike; what is culled or masked gets an empty box, and its row holds whatever came out. Products and
sums are rounded one by one (no fused multiply-add, divisions and roots to the last bit), the depth in the reference's
order: both surfaces of two views lie within rounding of each other, and a depth that differed in its last bit would
exchange Gaussians.

In torch's own operations this was 361 kernels a picture and 1050 with gradients, each of which takes microseconds to
start however few Gaussians there are.
"""

from __future__ import annotations

import numpy as np
import torch
import triton
import triton.language as tl

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs
from posegaussian.storage.model.cameras import PIXEL_CENTRE

ROW = 16
"""float32 of a Gaussian's row, a power of two: u, v, whitening (4), opacity, colour (3), depth, normal (3), padding."""
DEPTH = 10
"""Place of the depth in a row."""
W, T, FX, SKEW, CX, FY, CY, LEFT, RIGHT, TOP, BOTTOM, NEAR = 0, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21
LOW_PASS, LOW_PASS_2, VARIANCE_MIN, ALPHA_MIN, COMPENSATION_MIN, WIDTH, HEIGHT = 22, 23, 24, 25, 26, 27, 28
"""Places in a view: camera, limits of the ray, cut-offs, picture."""
LAST = 2**31 - 1
"""Beyond the bits of every depth, as a whole number."""
BLOCK = 128
"""Gaussians of a program."""
_LAST = tl.constexpr(LAST)
_ROW, _CENTRE = tl.constexpr(ROW), tl.constexpr(PIXEL_CENTRE)
_W, _T, _FX, _SKEW, _CX, _FY, _CY = (tl.constexpr(n) for n in (W, T, FX, SKEW, CX, FY, CY))
_LEFT, _RIGHT, _TOP, _BOTTOM, _NEAR = (tl.constexpr(n) for n in (LEFT, RIGHT, TOP, BOTTOM, NEAR))
_LOW_PASS, _LOW_PASS_2, _VARIANCE_MIN = (tl.constexpr(n) for n in (LOW_PASS, LOW_PASS_2, VARIANCE_MIN))
_ALPHA_MIN, _COMPENSATION_MIN = tl.constexpr(ALPHA_MIN), tl.constexpr(COMPENSATION_MIN)
_WIDTH, _HEIGHT = tl.constexpr(WIDTH), tl.constexpr(HEIGHT)


def view_of(camera: Camera, cutoffs: Cutoffs, device: torch.device) -> torch.Tensor:
    """[29] float32 that the kernels read of a camera and its cut-offs, on the device: px and metres, in the order of
    the places above."""
    k, pose = (
        np.asarray(m.detach().cpu() if isinstance(m, torch.Tensor) else m).astype(np.float32)
        for m in (camera.intrinsics, camera.world_to_camera)
    )
    fx, skew, cx, fy, cy = (float(k[i]) for i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2)))
    margin_x = cutoffs.frustum_margin * 0.5 * camera.width / fx
    margin_y = cutoffs.frustum_margin * 0.5 * camera.height / fy
    values = [*pose[:3, :3].reshape(-1), *pose[:3, 3], fx, skew, cx, fy, cy]
    values += [-cx / fx - margin_x, (camera.width - cx) / fx + margin_x]
    values += [-cy / fy - margin_y, (camera.height - cy) / fy + margin_y]
    values += [cutoffs.near, cutoffs.low_pass, cutoffs.low_pass**2, cutoffs.variance_min, cutoffs.alpha_min]
    values += [cutoffs.compensation_min, camera.width, camera.height]
    return torch.from_numpy(np.array(values, np.float32)).to(device)


@triton.jit
def triple(array, at, listed):
    """Three numbers of each Gaussian whose first lies at `at`."""
    return (
        tl.load(array + at, mask=listed, other=0.0),
        tl.load(array + at + 1, mask=listed, other=0.0),
        tl.load(array + at + 2, mask=listed, other=0.0),
    )


@triton.jit
def turned(view, x, y, z):
    """Camera axes of vectors in the world."""
    return (
        tl.load(view + _W) * x + tl.load(view + _W + 1) * y + tl.load(view + _W + 2) * z,
        tl.load(view + _W + 3) * x + tl.load(view + _W + 4) * y + tl.load(view + _W + 5) * z,
        tl.load(view + _W + 6) * x + tl.load(view + _W + 7) * y + tl.load(view + _W + 8) * z,
    )


@triton.jit
def in_camera(view, x, y, z):
    """Means in camera axes, metres, rounded as the reference rounds them."""
    a, b, c = turned(view, x, y, z)
    return a + tl.load(view + _T), b + tl.load(view + _T + 1), c + tl.load(view + _T + 2)


@triton.jit
def _bounded(value, least, most):
    return tl.minimum(tl.maximum(value, least), most)


@triton.jit
def near_ray(view, xz, yz):
    """The ray at which the Jacobian is taken: inside the widened frustum."""
    near_x = _bounded(xz, tl.load(view + _LEFT), tl.load(view + _RIGHT))
    return near_x, _bounded(yz, tl.load(view + _TOP), tl.load(view + _BOTTOM))


@triton.jit
def jacobian(view, near_x, near_y, z):
    """Two rows of J W in the world, px per metre."""
    fx, skew, fy = tl.load(view + _FX), tl.load(view + _SKEW), tl.load(view + _FY)
    w0, w1, w2 = tl.load(view + _W), tl.load(view + _W + 1), tl.load(view + _W + 2)
    w3, w4, w5 = tl.load(view + _W + 3), tl.load(view + _W + 4), tl.load(view + _W + 5)
    w6, w7, w8 = tl.load(view + _W + 6), tl.load(view + _W + 7), tl.load(view + _W + 8)
    turn, low = fx * near_x + skew * near_y, fy * near_y
    return (
        tl.div_rn(fx * w0 + skew * w3 - turn * w6, z),
        tl.div_rn(fx * w1 + skew * w4 - turn * w7, z),
        tl.div_rn(fx * w2 + skew * w5 - turn * w8, z),
        tl.div_rn(fy * w3 - low * w6, z),
        tl.div_rn(fy * w4 - low * w7, z),
        tl.div_rn(fy * w5 - low * w8, z),
    )


@triton.jit
def dot(a0, a1, a2, b0, b1, b2):
    """Of two vectors."""
    return a0 * b0 + a1 * b1 + a2 * b2


@triton.jit
def cross(a0, a1, a2, b0, b1, b2):
    """Of two vectors."""
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@triton.jit
def covariance(view, a0, a1, a2, b0, b1, b2):
    """(a, b, c, det, det before the low pass, cross product) of rows A and B of M = J W R S, px^2 and px^4."""
    low = tl.load(view + _LOW_PASS)
    a, b, c = dot(a0, a1, a2, a0, a1, a2), dot(a0, a1, a2, b0, b1, b2), dot(b0, b1, b2, b0, b1, b2)
    n0, n1, n2 = cross(a0, a1, a2, b0, b1, b2)
    sharp = dot(n0, n1, n2, n0, n1, n2)
    return a + low, b, c + low, sharp + low * (a + c) + tl.load(view + _LOW_PASS_2), sharp, n0, n1, n2


@triton.jit
def compensation(view, sharp, det, COMPENSATED: tl.constexpr):
    """Opacity's factor sqrt(det before the low pass / det), bounded below; 1 where it is off."""
    factor = sharp * 0.0 + 1.0
    if COMPENSATED:
        factor = tl.maximum(tl.sqrt_rn(tl.div_rn(sharp, det)), tl.load(view + _COMPENSATION_MIN))
    return factor


@triton.jit
def whitening(a, b, c, det):
    """(Whether a is the larger diagonal entry of [[a, b], [b, c]], that entry, first, second, slope), so that with d
    along its axis and across it p = first d_along and q = second (d_across - slope d_along): a square root of the
    conic."""
    wide = a >= c
    pivot = tl.where(wide, a, c)
    first, second = tl.div_rn(1.0, tl.sqrt_rn(pivot)), tl.sqrt_rn(tl.div_rn(pivot, det))
    return wide, pivot, first, second, tl.div_rn(b, pivot)


@triton.jit
def finite(value):
    """Nothing times 0 but what is not finite differs from 0."""
    return value * 0.0 == 0.0


@triton.jit
def _tiles(centre, half, size, TILE: tl.constexpr):
    """(first, one past the last) tile whose pixel centres lie within `half` of the centre; equal for none."""
    first = _bounded(tl.ceil(centre - half - _CENTRE), 0.0, size)
    last = _bounded(tl.floor(centre + half - _CENTRE), -1.0, size - 1.0)
    low, high = first.to(tl.int32) // TILE, last.to(tl.int32) // TILE + 1
    return low, tl.where(last < first, low, high)


@triton.jit(do_not_specialize=["number"])
def project(
    mean, rotation, scale, opacity, color, view, rows, boxes, depths, reached, tallies, number,
    TILE: tl.constexpr, COMPENSATED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill rows [N, ROW], boxes [N, 4] int32 (tiles x0, y0, x1, y1, half open), depths [N] int32 (a depth's bits,
    `LAST` where no tile is reached) and reached [N] int32 (tiles), of mean [N, 3], rotation [N, 3, 3], scale [N, 3],
    opacity [N] and color [N, 3], contiguous float32 as `Gaussians` has them, and a view; add to tallies [2] int64 how
    many tiles are reached, and how many Gaussians are masked because they or their projections are not finite."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    listed = i < number
    i = i.to(tl.int64)
    mx, my, mz = triple(mean, 3 * i, listed)
    r0, r1, r2 = triple(rotation, 9 * i, listed)
    r3, r4, r5 = triple(rotation, 9 * i + 3, listed)
    r6, r7, r8 = triple(rotation, 9 * i + 6, listed)
    s0, s1, s2 = triple(scale, 3 * i, listed)
    red, green, blue = triple(color, 3 * i, listed)
    given = tl.load(opacity + i, mask=listed, other=0.0)
    valid = finite(mx) & finite(my) & finite(mz) & finite(given) & finite(s0) & finite(s1) & finite(s2)
    valid &= finite(r0) & finite(r1) & finite(r2) & finite(r3) & finite(r4) & finite(r5) & finite(r6)
    valid &= finite(r7) & finite(r8) & finite(red) & finite(green) & finite(blue)
    x, y, z = in_camera(view, mx, my, mz)
    seen = listed & valid & (z > tl.load(view + _NEAR)) & (given >= tl.load(view + _ALPHA_MIN))
    z = tl.where(seen, z, 1.0)
    xz, yz = tl.div_rn(x, z), tl.div_rn(y, z)
    u = tl.load(view + _FX) * xz + tl.load(view + _SKEW) * yz + tl.load(view + _CX)
    v = tl.load(view + _FY) * yz + tl.load(view + _CY)
    near_x, near_y = near_ray(view, xz, yz)
    j0, j1, j2, k0, k1, k2 = jacobian(view, near_x, near_y, z)
    a, b, c, det, sharp, _, _, _ = covariance(
        view,
        dot(j0, j1, j2, r0, r3, r6) * s0,
        dot(j0, j1, j2, r1, r4, r7) * s1,
        dot(j0, j1, j2, r2, r5, r8) * s2,
        dot(k0, k1, k2, r0, r3, r6) * s0,
        dot(k0, k1, k2, r1, r4, r7) * s1,
        dot(k0, k1, k2, r2, r5, r8) * s2,
    )
    sane = finite(det) & finite(u) & finite(v) & finite(a) & finite(c)
    thick = det > tl.load(view + _VARIANCE_MIN) * (a + c)
    keep = seen & sane & thick
    a, c, det = tl.where(keep, a, 1.0), tl.where(keep, c, 1.0), tl.where(keep, det, 1.0)
    shown = given * compensation(view, tl.where(keep, sharp, 0.0), det, COMPENSATED)
    keep &= shown >= tl.load(view + _ALPHA_MIN)
    reach = 2.0 * tl.log(tl.where(keep, tl.div_rn(shown, tl.load(view + _ALPHA_MIN)), 1.0))
    # float32 rounding at 8k px
    x0, x1 = _tiles(tl.where(keep, u, 0.0), tl.sqrt_rn(reach * a) + 0.01, tl.load(view + _WIDTH), TILE)
    y0, y1 = _tiles(tl.where(keep, v, 0.0), tl.sqrt_rn(reach * c) + 0.01, tl.load(view + _HEIGHT), TILE)
    keep &= (x1 > x0) & (y1 > y0)
    wide, _, first, second, slope = whitening(a, b, c, det)
    slanted = -slope * second
    n0, n1, n2 = turned(view, r2, r5, r8)
    sign = tl.where(dot(n0, n1, n2, x, y, z) > 0.0, -1.0, 1.0)
    row, box = rows + i * _ROW, boxes + i * 4
    tl.store(row, u, mask=listed)
    tl.store(row + 1, v, mask=listed)
    tl.store(row + 2, tl.where(wide, first, 0.0), mask=listed)
    tl.store(row + 3, tl.where(wide, 0.0, first), mask=listed)
    tl.store(row + 4, tl.where(wide, slanted, second), mask=listed)
    tl.store(row + 5, tl.where(wide, second, slanted), mask=listed)
    tl.store(row + 6, shown, mask=listed)
    tl.store(row + 7, red, mask=listed)
    tl.store(row + 8, green, mask=listed)
    tl.store(row + 9, blue, mask=listed)
    tl.store(row + 10, z, mask=listed)
    tl.store(row + 11, n0 * sign, mask=listed)
    tl.store(row + 12, n1 * sign, mask=listed)
    tl.store(row + 13, n2 * sign, mask=listed)
    tl.store(box, tl.where(keep, x0, 0), mask=listed)
    tl.store(box + 1, tl.where(keep, y0, 0), mask=listed)
    tl.store(box + 2, tl.where(keep, x1, 0), mask=listed)
    tl.store(box + 3, tl.where(keep, y1, 0), mask=listed)
    number_of_tiles = tl.where(keep, (x1 - x0) * (y1 - y0), 0)
    tl.store(reached + i, number_of_tiles, mask=listed)
    tl.store(depths + i, tl.where(keep, z.to(tl.int32, bitcast=True), _LAST), mask=listed)
    # whole numbers add up to the same in any order
    tl.atomic_add(tallies, tl.sum(number_of_tiles.to(tl.int64), 0))
    tl.atomic_add(tallies + 1, tl.sum((listed & (~valid | (seen & ~sane))).to(tl.int64), 0))
