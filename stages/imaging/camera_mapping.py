"""Where a pixel of `frames/*` lies in the captured picture, and back: scale, undistortion and crop as plain geometry.

Three pixel grids, all with our pixel centres: *captured* (the file's pixels), *calibrated* (those the intrinsics were
measured in; captured x is calibrated scale x + offset) and *frames* (calibrated without distortion, scaled down, and
widened to what was filmed).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.imaging.facts import CROP_SCALE, UNDISTORTION
from posegaussian.storage.model.cameras import Rig

WIDEST = 1.5
"""Sides of the calibrated picture that one without distortion has, at most: a fisheye's rim is stretched without
end."""
LEAST_GROWTH = 0.01
"""Share of its length by which one side must move out for any of a picture to: what a mild lens leaves outside is no
part of anybody. `balance`, whose sides would move by a two-hundredth, loses 0.2 dB by it."""
IDENTITY = np.array([1.0, 0.0, 0.0])
"""Scale and offset between captured and calibrated pixels that are the same."""
STANDS = 1e-14
"""Length of the step, on the plane z = 1, by which a point stands where Newton's method leaves it: rounding moves it by
as much, and a pixel is 1e-4 or more."""
BORDER = 65
"""Points along a side of a captured picture at which the lens is undone; it bends them into smooth curves."""


def switched(source_rig: Rig, crops: np.ndarray, facts: Facts) -> tuple[Rig, np.ndarray]:
    """The lenses and crops [V, 3] that count:
    without distortion while `undistortion` is off, identity while `crop_scale` is."""
    if UNDISTORTION not in facts:
        source_rig = replace(source_rig, distortion=np.zeros_like(source_rig.distortion))
    return source_rig, crops if CROP_SCALE in facts else np.tile([1.0, 0.0, 0.0], (len(source_rig), 1))


def undistorted(rig: Rig, source_rig: Rig, captured: np.ndarray, crops: np.ndarray) -> Rig:
    """Cameras of a `frames_rig` with pictures that reach as far as the calibrated ones filmed, of the same focal
    lengths, but for what scaling to whole pixels takes.

    captured [V, 2] (width, height) px of the pictures; crops [V, 3] (scale, dx, dy). A barrel lens shows more than the
    calibrated picture would hold without it: each side moves out as far as it is filmed from end to end. So no pixel is
    added that no picture has, which masks would tell empty, and of what was filmed the corners' tips alone stay
    outside: 7 % of the picture of a wide action camera, 24 % where no side moves. Sides never move in, and become
    `WIDEST` times as long at most; where the lens model folds back in a corner, all stay. They move by whole calibrated
    pixels: sampled between its pixels a picture that a lens hardly bends loses an eighth of its sharpness.
    """
    k, size = rig.intrinsics.copy(), rig.size.copy()
    for v in np.flatnonzero(source_rig.distortion.any(axis=1)):
        scale, low = rig.size[v] / source_rig.size[v], crops[v, 1:]
        lens, filmed = (source_rig.intrinsics[v], source_rig.distortion[v]), (low, low + crops[v, 0] * captured[v])
        grown = np.array(_grown(*map(_row, (*lens, source_rig.size[v], *filmed, 1 / scale))))
        if (grown >= LEAST_GROWTH * source_rig.size[v]).any():
            whole = source_rig.size[v] + grown.sum(axis=0)
            size[v] = np.rint(whole * scale)
            k[v] = source_rig.intrinsics[v]
            k[v, :2, 2] += grown[0]
            k[v, :2] *= (size[v] / whole)[:, None]
    return replace(rig, intrinsics=k, size=size) if (size != rig.size).any() else rig


def _row(values: np.ndarray) -> tuple[float, ...]:
    return tuple(values.ravel().tolist())


@lru_cache(maxsize=4096)  # planning asks again for every task
def _grown(
    intrinsics: tuple[float, ...],
    lens: tuple[float, ...],
    size: tuple[float, ...],
    low: tuple[float, ...],
    high: tuple[float, ...],
    least: tuple[float, ...],
) -> tuple[tuple[int, int], tuple[int, int]]:
    """How far (the left and the upper), (the right and the lower) side of a calibrated picture of `size` px move
    out, in px, if its part from low [2] to high [2] px was filmed; by less than `least` [2] none does.

    Intrinsics [9] row by row, distortion [8].
    """
    k, distortion = np.reshape(intrinsics, (3, 3)), np.array(lens)
    along, grown = np.linspace(low, high, BORDER), np.zeros((2, 2), np.int64)
    for end, (at, innermost) in enumerate(((low, np.max), (high, np.min))):
        for axis in range(2):
            side = along.copy()
            side[:, axis] = at[axis]
            seen = frames_positions(side, k, k, distortion, IDENTITY)[:, axis]
            if (known := seen[np.isfinite(seen)]).size:
                out = innermost(known) - size[axis] if end else -innermost(known)
                grown[end, axis] = np.floor(min(out, (WIDEST - 1) / 2 * size[axis])) if out >= least[axis] else 0
    (x0, y0), (x1, y1) = -grown[0], size + grown[1]
    corners = _apply(np.linalg.inv(k), np.array([[x0, y0], [x1, y0], [x0, y1], [x1, y1]]))
    if np.linalg.norm(corners, axis=1).max() > reach(distortion):  # the model folds back in a corner
        return (0, 0), (0, 0)
    left, upper, right, lower = grown.ravel().tolist()
    return (left, upper), (right, lower)


def left_out(source_rig: Rig, view: int) -> float:
    """Share of a camera's calibrated picture that is not in the `undistorted` one: the tips of its corners, and what
    the lens model cannot undo."""
    one = source_rig.subset([view])
    seen, distortion = undistorted(frames_rig(one, None), one, one.size, IDENTITY[None]), one.distortion[0]
    ways = np.diff(corners := np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]), axis=0)
    outline = (corners[:-1, None] + np.linspace(0, 1, BORDER)[:, None] * ways[:, None]).reshape(-1, 2) * seen.size[0]
    ideal = _apply(np.linalg.inv(seen.intrinsics[0]), outline)
    within = np.minimum(1, reach(distortion) / np.maximum(np.linalg.norm(ideal, axis=1, keepdims=True), 1e-9))
    x, y = np.clip(_apply(one.intrinsics[0], distort(ideal * within, distortion)), 0, one.size[0]).T
    shown = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))  # area within a closed line
    return 1 - shown / float(np.prod(one.size[0]))


def unreduced_size(rig: Rig, source_rig: Rig) -> np.ndarray:
    """[V, 2] int px that the pictures of a rig without lenses have at the resolution of the calibrated one."""
    focal = source_rig.intrinsics[:, [0, 1], [0, 1]] / rig.intrinsics[:, [0, 1], [0, 1]]
    return np.asarray(np.rint(rig.size * focal), dtype=np.int64)


def frames_size(calibrated: tuple[int, int], longest: int | None) -> tuple[int, int]:
    """(width, height) px of a camera's frames: the longest side is `longest`, never more than the calibrated one."""
    width, height = int(calibrated[0]), int(calibrated[1])
    if longest is None or longest >= max(width, height):
        return width, height
    ratio = longest / max(width, height)
    return max(1, round(width * ratio)), max(1, round(height * ratio))


def frames_rig(source_rig: Rig, longest: int | None) -> Rig:
    """Cameras of `frames/*`: calibrated ones scaled to whole pixels, each axis by its exact ratio, without distortion,
    before they are `undistorted`.

    `longest`: px of the longer side, or None for the calibrated size.

    With our pixel centres a scaled picture spans [0, k w], so a whole row of the intrinsics is multiplied by k.
    """
    size = np.array([frames_size(tuple(s), longest) for s in source_rig.size], dtype=np.int64).reshape(-1, 2)
    intrinsics = source_rig.intrinsics.copy()
    intrinsics[:, :2] *= (size / source_rig.size)[:, :, None]
    return Rig(source_rig.names, intrinsics, np.zeros_like(source_rig.distortion), source_rig.world_to_camera, size)


def distort(normalised: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Ideal points [..., 2] on the plane z = 1 -> where the lens puts them, by OpenCV's rational model.

    `distortion` is [8] k1 k2 p1 p2 k3 k4 k5 k6: x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) plus the
    tangential 2 p1 x y + p2 (r² + 2 x²), and likewise for y with p1 and p2 exchanged.
    """
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    p1, p2 = distortion[2], distortion[3]
    radial = _radial(r2, distortion)
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)],
        axis=-1,
    )


def _radial(r2: np.ndarray, d: np.ndarray) -> np.ndarray:
    return (1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))) / (1 + r2 * (d[5] + r2 * (d[6] + r2 * d[7])))


def undistort(distorted: np.ndarray, distortion: np.ndarray, iterations: int = 30) -> np.ndarray:
    """Inverse of `distort`, [..., 2], by Newton's method with a numerical Jacobian; NaN where it does not converge.

    Points outside the model's one-to-one range (`reach`) have no inverse. Points that stand are not asked again: a few
    iterations do for nearly all.
    """
    target = np.asarray(distorted, dtype=np.float64).reshape(-1, 2)
    x, moving = target.copy(), np.arange(len(target))
    for _ in range(iterations):
        step = _newton_step(x[moving], target[moving], distortion)
        x[moving] -= step
        moving = moving[~(np.abs(step).max(axis=-1) <= STANDS)]
        if not moving.size:
            break
    wrong = ~(np.linalg.norm(distort(x, distortion) - target, axis=-1) < 1e-9)
    wrong |= np.linalg.norm(x, axis=-1) > reach(distortion)
    x[wrong] = np.nan
    return x.reshape(np.shape(distorted))


def _newton_step(x: np.ndarray, target: np.ndarray, distortion: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """[N, 2] by which ideal points x [N, 2] are off those that the lens puts at target [N, 2], to first order; slopes
    are differences over h either way."""
    ways = h * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    here, right, left, down, up = distort(x + ways[:, None], distortion)
    (ex, ey), dx, dy = (here - target).T, ((right - left) / (2 * h)).T, ((down - up) / (2 * h)).T
    determinant = dx[0] * dy[1] - dy[0] * dx[1]
    safe = np.where(np.abs(determinant) < 1e-9, 1.0, determinant)
    return np.stack([dy[1] * ex - dy[0] * ey, dx[0] * ey - dx[1] * ex], axis=-1) / safe[:, None]


def reach(distortion: np.ndarray, limit: float = 10.0) -> float:
    """Distance from the axis, on the plane z = 1, up to which the radial model is one-to-one; `limit` (84°) if
    everywhere.

    Beyond it the polynomial folds back, and undistorted corners would show a mirrored ghost of the picture.
    """
    r = np.linspace(0.0, limit, 20001)
    mapped = r * _radial(r * r, distortion)
    falling = ~(np.diff(mapped) > 0)
    return float(r[np.argmax(falling)]) if falling.any() else limit


def one_to_one(rig: Rig, view: int, farthest: float = np.inf) -> float:
    """How far the lens model of a calibrated camera can be undone: the farthest point that it shows before it folds
    back, over the farthest of the picture's border; at most `farthest`."""
    w, h = rig.size[view]
    k, d = rig.intrinsics[view], rig.distortion[view]
    corners = (np.array([[0, 0], [w, 0], [0, h], [w, h]]) - k[:2, 2]) / k[[0, 1], [0, 1]]
    shown = np.linalg.norm(distort(np.array([reach(d), 0.0]), d))
    return float(min(farthest, shown / np.linalg.norm(corners, axis=1).max()))


def captured_positions(
    pixels: np.ndarray, intrinsics: np.ndarray, source_intrinsics: np.ndarray, distortion: np.ndarray, crop: np.ndarray
) -> np.ndarray:
    """Frames pixels [..., 2] -> captured pixels [..., 2]; NaN where the lens model has no picture of that direction.

    intrinsics [3, 3] of `frames/*`; source_intrinsics [3, 3] and distortion [8] as calibrated; crop [3] (scale, dx,
    dy).
    """
    ideal = _apply(np.linalg.inv(intrinsics), pixels)
    if np.any(distortion):
        outside = np.linalg.norm(ideal, axis=-1) > reach(distortion)
        ideal = np.where(outside[..., None], np.nan, distort(ideal, distortion))
    return (_apply(source_intrinsics, ideal) - crop[1:]) / crop[0]


def frames_positions(
    captured: np.ndarray,
    intrinsics: np.ndarray,
    source_intrinsics: np.ndarray,
    distortion: np.ndarray,
    crop: np.ndarray,
) -> np.ndarray:
    """Captured pixels [..., 2] -> frames pixels [..., 2], the inverse of `captured_positions`; for joints and boxes."""
    ideal = _apply(np.linalg.inv(source_intrinsics), np.asarray(captured) * crop[0] + crop[1:])
    if np.any(distortion):
        ideal = undistort(ideal, distortion)
    return _apply(intrinsics, ideal)


def _apply(affine: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(points, dtype=np.float64) @ affine[:2, :2].T + affine[:2, 2]
