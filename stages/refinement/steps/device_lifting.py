"""Offsets on a device to Gaussians in the world, their slopes back, and Adam's moves: one kernel each, a Gaussian or a
number a lane. What is computed: `SharedGaussians`, `lifting.Rays` and the CPU's Adam."""

from __future__ import annotations

from itertools import accumulate

import triton
import triton.language as tl

from posegaussian.stages.refinement.steps.attributes import CHANNELS

BLOCK = 128
"""Lanes of a program."""
COLOR, SCALE, NORMAL, OPACITY, DEPTH, TWIST, SHIFT = accumulate(list(CHANNELS.values())[:-1], initial=0)
"""First rows of the offsets [14, N] and, but for turn and shift, of what they are added to [11, N]."""
_BLOCK = tl.constexpr(BLOCK)
_COLOR, _SCALE, _NORMAL, _OPACITY = (tl.constexpr(n) for n in (COLOR, SCALE, NORMAL, OPACITY))
_DEPTH, _TWIST, _SHIFT = (tl.constexpr(n) for n in (DEPTH, TWIST, SHIFT))


@triton.jit
def lifted(offsets, base, footprint, twist, rays, views, poses, pitch, mean, rotation, scale, opacity, color, n):
    """Write means [N, 3], axes [N, 3, 3], scales [N, 3], opacities [N] and colours [N, 3] of offsets [14, N] from base
    [11, N], footprints [N] and turns [2, N]; rays [2, N] at unit depth, views [N], their poses [V, 3, 4] and what a px
    is of their rays [V, 3]."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < n
    pose = poses + tl.load(views + at, mask=listed, other=0) * 12
    z = _value(offsets, base, _DEPTH, n, at, listed, tl.load(footprint + at, mask=listed, other=0.0))
    nx, ny, nz, _ = _normal(offsets, base, n, at, listed)
    c, s, _ = _turn(offsets, twist, n, at, listed)
    k, xy = _across(nx, ny, nz)
    ax, ay, az = 1.0 - k * nx * nx, -xy, nx  # the tangents that follow from the normal
    bx, by, bz = xy, k * ny * ny - 1.0, -ny
    x, y, _, _, _ = _ray(offsets, rays, views, pitch, n, at, listed)
    px = x * z - tl.load(pose + 3, mask=listed, other=0.0)
    py = y * z - tl.load(pose + 7, mask=listed, other=0.0)
    pz = z - tl.load(pose + 11, mask=listed, other=0.0)
    _to_world(pose, px, py, pz, mean + 3 * at, 1, listed)
    _to_world(pose, c * ax + s * bx, c * ay + s * by, c * az + s * bz, rotation + 9 * at, 3, listed)
    _to_world(pose, c * bx - s * ax, c * by - s * ay, c * bz - s * az, rotation + 9 * at + 1, 3, listed)
    _to_world(pose, nx, ny, nz, rotation + 9 * at + 2, 3, listed)
    for channel in tl.static_range(3):
        own = _value(offsets, base, _COLOR + channel, n, at, listed, 1.0)
        tl.store(color + 3 * at + channel, own, mask=listed)
        size = tl.exp(_value(offsets, base, _SCALE + channel, n, at, listed, 1.0))
        tl.store(scale + 3 * at + channel, size, mask=listed)
    tl.store(opacity + at, _sigmoid(_value(offsets, base, _OPACITY, n, at, listed, 1.0)), mask=listed)


@triton.jit
def slopes_of(
    offsets, base, footprint, twist, rays, views, poses, pitch,
    by_mean, by_rotation, by_scale, by_opacity, by_color, out, n,
):  # fmt: skip
    """Write the slopes [14, N] by the offsets, of slopes by what `lifted` writes. What has no length has no slope."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < n
    pose = poses + tl.load(views + at, mask=listed, other=0) * 12
    mx, my, mz = _to_camera(pose, by_mean + 3 * at, 1, listed)
    x, y, by_right, slant, by_down = _ray(offsets, rays, views, pitch, n, at, listed)
    tall = tl.load(footprint + at, mask=listed, other=0.0)
    tl.store(out + _DEPTH * n + at, (x * mx + y * my + mz) * tall, mask=listed)
    z = _value(offsets, base, _DEPTH, n, at, listed, tall)
    tl.store(out + _SHIFT * n + at, z * by_right * mx, mask=listed)
    tl.store(out + (_SHIFT + 1) * n + at, z * (slant * mx + by_down * my), mask=listed)

    nx, ny, nz, long = _normal(offsets, base, n, at, listed)
    c, s, turned = _turn(offsets, twist, n, at, listed)
    k, xy = _across(nx, ny, nz)
    tx, ty, tz = _to_camera(pose, by_rotation + 9 * at, 3, listed)
    ux, uy, uz = _to_camera(pose, by_rotation + 9 * at + 1, 3, listed)
    fx, fy, fz = _to_camera(pose, by_rotation + 9 * at + 2, 3, listed)
    ax, ay, az = 1.0 - k * nx * nx, -xy, nx
    bx, by, bz = xy, k * ny * ny - 1.0, -ny
    by_c = tx * ax + ty * ay + tz * az + ux * bx + uy * by + uz * bz
    by_s = tx * bx + ty * by + tz * bz - ux * ax - uy * ay - uz * az
    along = c * by_c + s * by_s
    cosine, sine = tl.load(twist + at, mask=listed, other=1.0), tl.load(twist + n + at, mask=listed, other=0.0)
    by_turn = _over((by_s - s * along) * cosine - (by_c - c * along) * sine, turned)
    tl.store(out + _TWIST * n + at, by_turn, mask=listed)

    a0, a1, a2 = c * tx - s * ux, c * ty - s * uy, c * tz - s * uz
    b0, b1, b2 = s * tx + c * ux, s * ty + c * uy, s * tz + c * uz
    mixed = b0 - a1
    by_k = nx * ny * mixed - a0 * nx * nx + b1 * ny * ny
    by_x = fx + k * (ny * mixed - 2.0 * nx * a0) + a2
    by_y = fy + k * (nx * mixed + 2.0 * ny * b1) - b2
    by_z = fz + k * k * by_k
    along = nx * by_x + ny * by_y + nz * by_z
    tl.store(out + _NORMAL * n + at, _over(by_x - nx * along, long), mask=listed)
    tl.store(out + (_NORMAL + 1) * n + at, _over(by_y - ny * along, long), mask=listed)
    tl.store(out + (_NORMAL + 2) * n + at, _over(by_z - nz * along, long), mask=listed)

    for channel in tl.static_range(3):
        own = tl.load(by_color + 3 * at + channel, mask=listed, other=0.0)
        tl.store(out + (_COLOR + channel) * n + at, own, mask=listed)
        size = tl.exp(_value(offsets, base, _SCALE + channel, n, at, listed, 1.0))
        own = tl.load(by_scale + 3 * at + channel, mask=listed, other=0.0) * size
        tl.store(out + (_SCALE + channel) * n + at, own, mask=listed)
    p = _sigmoid(_value(offsets, base, _OPACITY, n, at, listed, 1.0))
    own = tl.load(by_opacity + at, mask=listed, other=0.0) * p * (1.0 - p)
    tl.store(out + _OPACITY * n + at, own, mask=listed)


@triton.jit
def adam(values, slopes, mean, square, rates, lower, upper, masked, shorter, unbiased, nearer, larger, n, total):
    """Move values [14, N] within their bounds against slopes, and the running means of these and of their squares, all
    in place: by rates [14] times `shorter`. Slopes that are not finite count as 0, and one more each in `masked`."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < total
    g = tl.load(slopes + at, mask=listed, other=0.0)
    finite = tl.abs(g) < float("inf")  # no number is in no relation
    lost = tl.sum(tl.where(finite, 0, 1), axis=0)
    if lost > 0:
        tl.atomic_add(masked, lost)
    g = tl.where(finite, g, 0.0)
    m, q = tl.load(mean + at, mask=listed, other=0.0), tl.load(square + at, mask=listed, other=0.0)
    m += nearer * (g - m)
    q += larger * (g * g - q)
    tl.store(mean + at, m, mask=listed)
    tl.store(square + at, q, mask=listed)
    size = tl.sqrt_rn(q * unbiased)
    moves = (size > 0.0) & (size < float("inf"))
    rate = tl.load(rates + at // n, mask=listed, other=0.0) * shorter
    v = tl.load(values + at, mask=listed, other=0.0)
    v = tl.where(moves, v - rate * tl.div_rn(m, tl.where(moves, size, 1.0)), v)
    least, most = tl.load(lower + at, mask=listed, other=0.0), tl.load(upper + at, mask=listed, other=0.0)
    tl.store(values + at, tl.minimum(tl.maximum(v, least), most), mask=listed)


@triton.jit
def _value(offsets, base, row, n, at, listed, unit):
    """A row's values, its offsets in so many of their units."""
    offset = tl.load(offsets + row * n + at, mask=listed, other=0.0)
    return tl.load(base + row * n + at, mask=listed, other=0.0) + offset * unit


@triton.jit
def _ray(offsets, rays, views, pitch, n, at, listed):
    """Where rays that are shifted by their offsets are at unit depth, x and y, and what a px is of them."""
    own = pitch + tl.load(views + at, mask=listed, other=0) * 3
    by_right, slant = tl.load(own, mask=listed, other=0.0), tl.load(own + 1, mask=listed, other=0.0)
    by_down = tl.load(own + 2, mask=listed, other=0.0)
    right = tl.load(offsets + _SHIFT * n + at, mask=listed, other=0.0)
    down = tl.load(offsets + (_SHIFT + 1) * n + at, mask=listed, other=0.0)
    x = tl.load(rays + at, mask=listed, other=0.0) + by_right * right + slant * down
    y = tl.load(rays + n + at, mask=listed, other=0.0) + by_down * down
    return x, y, by_right, slant, by_down


@triton.jit
def _normal(offsets, base, n, at, listed):
    """A normal at unit length, and its length; one without a length faces the camera."""
    x = _value(offsets, base, _NORMAL, n, at, listed, 1.0)
    y = _value(offsets, base, _NORMAL + 1, n, at, listed, 1.0)
    z = _value(offsets, base, _NORMAL + 2, n, at, listed, 1.0)
    length = tl.sqrt_rn(x * x + y * y + z * z)
    some = length > 0.0
    safe = tl.where(some, length, 1.0)
    x, y, z = tl.div_rn(x, safe), tl.div_rn(y, safe), tl.div_rn(z, safe)
    return tl.where(some, x, 0.0), tl.where(some, y, 0.0), tl.where(some, z, -1.0), length


@triton.jit
def _turn(offsets, twist, n, at, listed):
    """A turn at unit length, and its length; one without a length is none."""
    cosine, sine = tl.load(twist + at, mask=listed, other=1.0), tl.load(twist + n + at, mask=listed, other=0.0)
    offset = tl.load(offsets + _TWIST * n + at, mask=listed, other=0.0)
    c, s = cosine - offset * sine, sine + offset * cosine
    length = tl.sqrt_rn(c * c + s * s)
    some = length > 0.0
    safe = tl.where(some, length, 1.0)
    return tl.where(some, tl.div_rn(c, safe), 1.0), tl.where(some, tl.div_rn(s, safe), 0.0), length


@triton.jit
def _across(nx, ny, nz):
    """What the tangents of a normal are made of: `posegaussian.stages.geometry.tangent_frame`."""
    one = nz * 0.0 + 1.0
    k = tl.div_rn(one, 1.0 - nz)
    return k, k * nx * ny


@triton.jit
def _to_world(pose, x, y, z, out, stride, listed):
    """Write a vector of camera axes in those of the world, three numbers so far apart."""
    for i in tl.static_range(3):
        right = tl.load(pose + i, mask=listed, other=0.0)
        down = tl.load(pose + 4 + i, mask=listed, other=0.0)
        ahead = tl.load(pose + 8 + i, mask=listed, other=0.0)
        tl.store(out + i * stride, right * x + down * y + ahead * z, mask=listed)


@triton.jit
def _to_camera(pose, array, stride, listed):
    """Camera axes of a vector in the world, three numbers so far apart."""
    x = tl.load(array, mask=listed, other=0.0)
    y = tl.load(array + stride, mask=listed, other=0.0)
    z = tl.load(array + 2 * stride, mask=listed, other=0.0)
    return _row(pose, x, y, z, listed), _row(pose + 4, x, y, z, listed), _row(pose + 8, x, y, z, listed)


@triton.jit
def _row(pose, x, y, z, listed):
    right = tl.load(pose, mask=listed, other=0.0)
    down = tl.load(pose + 1, mask=listed, other=0.0)
    return right * x + down * y + tl.load(pose + 2, mask=listed, other=0.0) * z


@triton.jit
def _sigmoid(x):
    one = x * 0.0 + 1.0
    return tl.div_rn(one, 1.0 + tl.exp(-x))


@triton.jit
def _over(value, length):
    """Divided by a length; 0 where there is none."""
    some = length > 0.0
    return tl.where(some, tl.div_rn(value, tl.where(some, length, 1.0)), 0.0)
