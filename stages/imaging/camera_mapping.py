"""Where a pixel of `frames/*` lies in the captured picture, and back: scale, undistortion and crop as plain geometry.

Three pixel grids, all with our pixel centres: *captured* (the file's pixels), *calibrated* (those the intrinsics were
measured in; captured x is calibrated scale x + offset) and *frames* (calibrated without distortion, scaled down).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.imaging.facts import CROP_SCALE, UNDISTORTION
from posegaussian.storage.model.cameras import Rig


def switched(source_rig: Rig, crops: np.ndarray, facts: Facts) -> tuple[Rig, np.ndarray]:
    """The lenses and crops [V, 3] that count:
    without distortion while `undistortion` is off, identity while `crop_scale` is."""
    if UNDISTORTION not in facts:
        source_rig = replace(source_rig, distortion=np.zeros_like(source_rig.distortion))
    return source_rig, crops if CROP_SCALE in facts else np.tile([1.0, 0.0, 0.0], (len(source_rig), 1))


def frames_size(calibrated: tuple[int, int], longest: int | None) -> tuple[int, int]:
    """(width, height) px of a camera's frames: the longest side is `longest`, never more than the calibrated one."""
    width, height = int(calibrated[0]), int(calibrated[1])
    if longest is None or longest >= max(width, height):
        return width, height
    ratio = longest / max(width, height)
    return max(1, round(width * ratio)), max(1, round(height * ratio))


def frames_rig(source_rig: Rig, longest: int | None) -> Rig:
    """Cameras of `frames/*`: calibrated ones scaled to whole pixels, each axis by its exact ratio, without distortion.

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

    Points outside the model's one-to-one range (`reach`) have no inverse.
    """
    target = np.asarray(distorted, dtype=np.float64)
    x, h = target.copy(), 1e-6
    right, down = np.array([h, 0.0]), np.array([0.0, h])
    for _ in range(iterations):
        error = distort(x, distortion) - target
        dx = (distort(x + right, distortion) - distort(x - right, distortion)) / (2 * h)
        dy = (distort(x + down, distortion) - distort(x - down, distortion)) / (2 * h)
        determinant = dx[..., 0] * dy[..., 1] - dy[..., 0] * dx[..., 1]
        safe = np.where(np.abs(determinant) < 1e-9, 1.0, determinant)
        step = np.stack(
            [
                dy[..., 1] * error[..., 0] - dy[..., 0] * error[..., 1],
                dx[..., 0] * error[..., 1] - dx[..., 1] * error[..., 0],
            ],
            axis=-1,
        )
        x = x - step / safe[..., None]
    wrong = ~(np.linalg.norm(distort(x, distortion) - target, axis=-1) < 1e-9)
    wrong |= np.linalg.norm(x, axis=-1) > reach(distortion)
    return np.where(wrong[..., None], np.nan, x)


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
