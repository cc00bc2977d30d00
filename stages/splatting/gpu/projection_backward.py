"""Backward pass of the projection in Triton, one Gaussian a lane: from the sums of its gradient slots to gradients of
Gaussians and camera.

With p = first d_along and q = second (d_across - slope d_along), the sums of m = alpha dL/dalpha times 1, p, q, p^2,
p q, q^2 that compositing leaves are the gradients of opacity, centre, first, second and slope; the chain rule from
there is written out. Frustum limits are constants: a Gaussian beyond one gets no gradient through the clamped ray, as
in the reference.
"""

from __future__ import annotations

import triton
import triton.language as tl

from posegaussian.stages.splatting.gpu.composite import SLOT
from posegaussian.stages.splatting.gpu.projection import (
    COMPENSATION_MIN,
    FX,
    FY,
    LOW_PASS,
    SKEW,
    W,
    compensation,
    covariance,
    cross,
    dot,
    finite,
    in_camera,
    jacobian,
    near_ray,
    triple,
    turned,
    whitening,
)

CAMERA_GRADIENTS = 17
"""World to camera rotation (9) and translation (3), fx, skew, cx, fy, cy."""
BLOCK = 128
"""Gaussians of a program."""
_SLOT, _CAMERA_GRADIENTS = tl.constexpr(SLOT), tl.constexpr(CAMERA_GRADIENTS)
_W, _FX, _SKEW, _FY = tl.constexpr(W), tl.constexpr(FX), tl.constexpr(SKEW), tl.constexpr(FY)
_LOW_PASS, _COMPENSATION_MIN = tl.constexpr(LOW_PASS), tl.constexpr(COMPENSATION_MIN)


@triton.jit
def _store(array, at, value, kept, listed):
    """0 where it is not kept."""
    tl.store(array + at, tl.where(kept, value, 0.0), mask=listed)


@triton.jit
def _store_triple(array, at, a, b, c, kept, listed):
    _store(array, at, a, kept, listed)
    _store(array, at + 1, b, kept, listed)
    _store(array, at + 2, c, kept, listed)


@triton.jit(do_not_specialize=["number"])
def project_backward(
    mean, rotation, scale, opacity, view, ids, bases, sums, d_mean, d_rotation, d_scale, d_opacity, d_color, d_camera,
    dropped, number,
    CHANNELS: tl.constexpr, COMPENSATED: tl.constexpr, CAMERA: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill the gradients of the N Gaussians, at their own places, from sums [N, SLOT] in the order of `ids` [N] int64;
    with CAMERA, also d_camera [N, CAMERA_GRADIENTS], what each adds to the camera's. Attributes and gradients as
    `project` takes the former; 0 where `bases` [N + 1] int64 tells of no slot.

    Adds to dropped [1] int32 how many have a number beyond float32: where it is one of a Gaussian's own, all of its are
    0, the camera's too; where it is one of the camera's, those alone.
    """
    k = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    listed = k < number
    k = k.to(tl.int64)
    i = tl.load(ids + k, mask=listed, other=0)
    seen = listed & (tl.load(bases + k + 1, mask=listed, other=0) > tl.load(bases + k, mask=listed, other=0))
    at = sums + k * _SLOT
    mass, mp, mq = triple(at, 0, listed)
    mpp, mpq, mqq = triple(at, 3, listed)
    mx, my, mz = triple(mean, 3 * i, listed)
    r0, r1, r2 = triple(rotation, 9 * i, listed)
    r3, r4, r5 = triple(rotation, 9 * i + 3, listed)
    r6, r7, r8 = triple(rotation, 9 * i + 6, listed)
    s0, s1, s2 = triple(scale, 3 * i, listed)
    given = tl.load(opacity + i, mask=listed, other=1.0)
    fx, skew, fy = tl.load(view + _FX), tl.load(view + _SKEW), tl.load(view + _FY)
    w0, w1, w2 = tl.load(view + _W), tl.load(view + _W + 1), tl.load(view + _W + 2)
    w3, w4, w5 = tl.load(view + _W + 3), tl.load(view + _W + 4), tl.load(view + _W + 5)
    w6, w7, w8 = tl.load(view + _W + 6), tl.load(view + _W + 7), tl.load(view + _W + 8)
    # the projection once more
    x, y, z = in_camera(view, mx, my, mz)
    z = tl.where(seen, z, 1.0)
    xz, yz = tl.div_rn(x, z), tl.div_rn(y, z)
    near_x, near_y = near_ray(view, xz, yz)
    j0, j1, j2, k0, k1, k2 = jacobian(view, near_x, near_y, z)
    a0, a1, a2 = dot(j0, j1, j2, r0, r3, r6), dot(j0, j1, j2, r1, r4, r7), dot(j0, j1, j2, r2, r5, r8)
    b0, b1, b2 = dot(k0, k1, k2, r0, r3, r6), dot(k0, k1, k2, r1, r4, r7), dot(k0, k1, k2, r2, r5, r8)
    p0, p1, p2, q0, q1, q2 = a0 * s0, a1 * s1, a2 * s2, b0 * s0, b1 * s1, b2 * s2
    a, b, c, det, sharp, n0, n1, n2 = covariance(view, p0, p1, p2, q0, q1, q2)
    a, c, det = tl.where(seen, a, 1.0), tl.where(seen, c, 1.0), tl.where(seen, det, 1.0)
    wide, pivot, first, second, slope = whitening(a, b, c, det)
    # centre, and whitening
    along, across = first * mp - slope * second * mq, second * mq
    du, dv = tl.where(wide, along, across), tl.where(wide, across, along)
    d_slope = tl.div_rn(second, first) * mpq
    d_pivot = tl.div_rn(0.5 * (mpp - mqq) - slope * d_slope, pivot)
    d_b, d_det = tl.div_rn(d_slope, pivot), tl.div_rn(0.5 * mqq, det)
    # opacity, and its compensation for the low pass
    factor = compensation(view, sharp, det, COMPENSATED)
    d_given = tl.div_rn(mass, given)
    d_sharp = d_det * 0.0
    if COMPENSATED:
        above = factor > tl.load(view + _COMPENSATION_MIN)
        share = tl.where(above, 0.5 * mass, 0.0)  # factor dL/dfactor / 2
        d_det -= tl.div_rn(share, det)
        d_sharp = tl.div_rn(share, tl.where(above, sharp, 1.0))
    # rows of M
    low = tl.load(view + _LOW_PASS)
    d_a, d_c = tl.where(wide, d_pivot, 0.0) + low * d_det, tl.where(wide, 0.0, d_pivot) + low * d_det
    d_n = 2.0 * (d_det + d_sharp)
    n0, n1, n2 = d_n * n0, d_n * n1, d_n * n2
    l0, l1, l2 = cross(q0, q1, q2, n0, n1, n2)
    h0, h1, h2 = cross(n0, n1, n2, p0, p1, p2)
    dp0, dp1, dp2 = 2.0 * d_a * p0 + d_b * q0 + l0, 2.0 * d_a * p1 + d_b * q1 + l1, 2.0 * d_a * p2 + d_b * q2 + l2
    dq0, dq1, dq2 = 2.0 * d_c * q0 + d_b * p0 + h0, 2.0 * d_c * q1 + d_b * p1 + h1, 2.0 * d_c * q2 + d_b * p2 + h2
    t0, t1, t2 = a0 * dp0 + b0 * dq0, a1 * dp1 + b1 * dq1, a2 * dp2 + b2 * dq2
    e0, e1, e2, f0, f1, f2 = dp0 * s0, dp1 * s1, dp2 * s2, dq0 * s0, dq1 * s1, dq2 * s2
    # rotation, and the normal that is its third column
    u0, u1, u2 = d_det * 0.0, d_det * 0.0, d_det * 0.0
    if CHANNELS > 4:
        v0, v1, v2 = turned(view, r2, r5, r8)
        sign = tl.where(dot(v0, v1, v2, x, y, z) > 0.0, -1.0, 1.0)
        u0, u1, u2 = triple(at, 10, listed)
        u0, u1, u2 = sign * u0, sign * u1, sign * u2
    d0, d1, d2 = j0 * e0 + k0 * f0, j0 * e1 + k0 * f1, j0 * e2 + k0 * f2 + dot(w0, w3, w6, u0, u1, u2)
    d3, d4, d5 = j1 * e0 + k1 * f0, j1 * e1 + k1 * f1, j1 * e2 + k1 * f2 + dot(w1, w4, w7, u0, u1, u2)
    d6, d7, d8 = j2 * e0 + k2 * f0, j2 * e1 + k2 * f1, j2 * e2 + k2 * f2 + dot(w2, w5, w8, u0, u1, u2)
    # the two rows of J W, and the mean
    g0, g1, g2 = dot(r0, r1, r2, e0, e1, e2), dot(r3, r4, r5, e0, e1, e2), dot(r6, r7, r8, e0, e1, e2)
    h0, h1, h2 = dot(r0, r1, r2, f0, f1, f2), dot(r3, r4, r5, f0, f1, f2), dot(r6, r7, r8, f0, f1, f2)
    x_far, y_far = tl.div_rn(dot(g0, g1, g2, w6, w7, w8), z), tl.div_rn(dot(h0, h1, h2, w6, w7, w8), z)
    d_xz = fx * du - tl.where(near_x == xz, fx * x_far, 0.0)
    d_yz = skew * du + fy * dv - tl.where(near_y == yz, skew * x_far + fy * y_far, 0.0)
    shrunk = xz * d_xz + yz * d_yz + dot(g0, g1, g2, j0, j1, j2) + dot(h0, h1, h2, k0, k1, k2)
    dx, dy, dz = tl.div_rn(d_xz, z), tl.div_rn(d_yz, z), -tl.div_rn(shrunk, z)
    if CHANNELS > 3:
        dz += tl.load(at + 9, mask=listed, other=0.0)
    m0, m1, m2 = w0 * dx + w3 * dy + w6 * dz, w1 * dx + w4 * dy + w7 * dz, w2 * dx + w5 * dy + w8 * dz
    red, green, blue = triple(at, 6, listed)
    sound = finite(m0) & finite(m1) & finite(m2) & finite(t0) & finite(t1) & finite(t2) & finite(d_given)
    sound &= finite(d0) & finite(d1) & finite(d2) & finite(d3) & finite(d4) & finite(d5)
    sound &= finite(d6) & finite(d7) & finite(d8) & finite(red) & finite(green) & finite(blue)
    kept = seen & sound
    _store_triple(d_mean, 3 * i, m0, m1, m2, kept, listed)
    _store_triple(d_rotation, 9 * i, d0, d1, d2, kept, listed)
    _store_triple(d_rotation, 9 * i + 3, d3, d4, d5, kept, listed)
    _store_triple(d_rotation, 9 * i + 6, d6, d7, d8, kept, listed)
    _store_triple(d_scale, 3 * i, t0, t1, t2, kept, listed)
    _store(d_opacity, i, d_given, kept, listed)
    _store_triple(d_color, 3 * i, red, green, blue, kept, listed)
    if CAMERA:
        turn, lowered = fx * near_x + skew * near_y, fy * near_y
        i0, i1, i2 = tl.div_rn(g0, z), tl.div_rn(g1, z), tl.div_rn(g2, z)
        o0, o1, o2 = tl.div_rn(h0, z), tl.div_rn(h1, z), tl.div_rn(h2, z)
        c0, c1, c2 = fx * i0 + mx * dx + u0 * r2, fx * i1 + my * dx + u0 * r5, fx * i2 + mz * dx + u0 * r8
        c3, c4 = skew * i0 + fy * o0 + mx * dy + u1 * r2, skew * i1 + fy * o1 + my * dy + u1 * r5
        c5, c6 = skew * i2 + fy * o2 + mz * dy + u1 * r8, mx * dz + u2 * r2 - turn * i0 - lowered * o0
        c7, c8 = my * dz + u2 * r5 - turn * i1 - lowered * o1, mz * dz + u2 * r8 - turn * i2 - lowered * o2
        d_fx = xz * du + tl.div_rn(dot(g0, g1, g2, w0, w1, w2), z) - near_x * x_far
        d_skew = yz * du + tl.div_rn(dot(g0, g1, g2, w3, w4, w5), z) - near_y * x_far
        d_fy = yz * dv + tl.div_rn(dot(h0, h1, h2, w3, w4, w5), z) - near_y * y_far
        sound &= finite(c0) & finite(c1) & finite(c2) & finite(c3) & finite(c4) & finite(c5) & finite(c6) & finite(c7)
        sound &= finite(c8) & finite(dx) & finite(dy) & finite(dz) & finite(d_fx) & finite(d_skew) & finite(d_fy)
        sound &= finite(du) & finite(dv)
        kept, to = seen & sound, d_camera + k * _CAMERA_GRADIENTS
        _store_triple(to, 0, c0, c1, c2, kept, listed)
        _store_triple(to, 3, c3, c4, c5, kept, listed)
        _store_triple(to, 6, c6, c7, c8, kept, listed)
        _store_triple(to, 9, dx, dy, dz, kept, listed)
        _store_triple(to, 12, d_fx, d_skew, du, kept, listed)
        _store(to, 15, d_fy, kept, listed)
        _store(to, 16, dv, kept, listed)
    tl.atomic_add(dropped, tl.sum((seen & ~sound).to(tl.int32), 0))
