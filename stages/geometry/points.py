"""Points between pictures and the world: captured pixels to frames pixels, projection, the place a rig looks at.

All pixels are in our convention (top-left centre at (0.5, 0.5)); normalised coordinates have no centre convention, so
OpenCV is called on those and no half pixel appears here.
"""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.geometry.subject import middle_rays
from posegaussian.storage.model.cameras import Rig

NEAR = 0.05
"""Metres along the optical axis below which a point counts as behind the camera."""
_ROUND_TRIP = 1e-4
"""Error, in normalised coordinates, above which a point lies outside the range where the lens model can be inverted."""


def to_frames(
    points: np.ndarray, captured_to_calibrated: np.ndarray, calibrated: Rig, frames: Rig, view: int
) -> tuple[np.ndarray, np.ndarray]:
    """Captured pixels [..., 2] of one view -> pixels of frames/* [..., 2], and whether each could be mapped [...].

    captured_to_calibrated: (scale, dx, dy) of that view. The lens of `calibrated` is undone; `frames` has the same pose
    and none. A point that the lens model maps nowhere (far outside the picture) is not mapped and comes back as zero.
    """
    scale, *offset = captured_to_calibrated
    pixels = np.asarray(points, dtype=np.float64).reshape(-1, 2) * scale + np.asarray(offset)
    ideal, mapped = _undistort(_normalise(pixels, calibrated.intrinsics[view]), calibrated.distortion[view])
    out = np.where(mapped[:, None], _denormalise(ideal, frames.intrinsics[view]), 0.0)
    return out.reshape(np.shape(points)), mapped.reshape(np.shape(points)[:-1])


def _normalise(pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] -> normalised coordinates, of one camera or of one camera for each pixel ([..., 3, 3])."""
    y = (pixels[..., 1] - intrinsics[..., 1, 2]) / intrinsics[..., 1, 1]
    x = (pixels[..., 0] - intrinsics[..., 0, 2] - intrinsics[..., 0, 1] * y) / intrinsics[..., 0, 0]
    return np.stack([x, y], axis=-1)


def _denormalise(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Normalised coordinates [..., 2] -> pixels, of one camera or of one camera for each point."""
    x, y = points[..., 0], points[..., 1]
    u = intrinsics[..., 0, 0] * x + intrinsics[..., 0, 1] * y + intrinsics[..., 0, 2]
    return np.stack([u, intrinsics[..., 1, 1] * y + intrinsics[..., 1, 2]], axis=-1)


def _undistort(points: np.ndarray, distortion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distorted normalised [n, 2] -> ideal normalised [n, 2], and whether distorting them again gives the input."""
    if not len(points) or not distortion.any():
        return points, np.ones(len(points), dtype=bool)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    ideal = cv2.undistortPoints(points[:, None], np.eye(3), distortion, criteria=stop).reshape(-1, 2)
    finite = np.isfinite(ideal[:, 0]) & np.isfinite(ideal[:, 1])
    ideal = np.where(finite[:, None], ideal, 0.0)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=-1)
    again = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), distortion)[0].reshape(-1, 2)
    return ideal, finite & (np.abs(again - points).max(axis=-1) < _ROUND_TRIP)


def project(rig: Rig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World points [..., 3] -> pixels [..., V, 2] and depth along the optical axis [..., V], metres, for a rig without
    lens.

    Pixels of points nearer than `NEAR` or behind the camera mean nothing; look at the depth.
    """
    camera = np.einsum("vij,...j->...vi", rig.rotations, points) + rig.world_to_camera[:, :3, 3]
    depth = camera[..., 2]
    return _denormalise(camera[..., :2] / np.where(depth > NEAR, depth, 1.0)[..., None], rig.intrinsics), depth


def rays(rig: Rig, views: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [T, J, 2] seen by views [T] -> normalised coordinates [T, J, 2]
    and unit directions in the world [T, J, 3]."""
    flat = _normalise(pixels, rig.intrinsics[views][:, None])
    direction = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return flat, np.einsum("tji,t...j->t...i", rig.rotations[views], direction)


def focus(rig: Rig) -> np.ndarray:
    """[3] the world point nearest to the rays through the middle of all pictures, metres: where the rig looks.

    Least squares over the distances to these rays; a weak pull to the world's origin decides what one camera or
    parallel rays leave open.
    """
    along = middle_rays(rig)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    return np.linalg.solve(across.sum(0) + 1e-6 * np.eye(3), (across @ rig.centres[..., None]).sum(0)[:, 0])
