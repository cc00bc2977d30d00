"""Do cameras, pictures and silhouettes agree with one another? Measures that need no truth."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres
from posegaussian.storage.model.masks import foreground

SAME_SURFACE = 0.01
"""Relative difference of two depths up to which two views see the same point."""
REACH = 4
"""Px to both sides of an outline in which the picture's own edge is looked for."""
STEPS = np.arange(-REACH, REACH + 0.25, 0.5, dtype=np.float32)
"""Px from the outline, outwards, at which the picture is looked up."""
OFFSETS = -(STEPS[1:] + STEPS[:-1]) / 2
"""By how much the outline lies outside an edge that is between two of these."""
CLEAR = 0.7
"""Share of REACH by which the ends of a profile must be inside and outside."""
EDGE = 12.0
"""Colour difference, 1/255, below which an outline has no edge to find."""


def reprojection_residual(rig: Rig, joints2d: np.ndarray, joints3d: np.ndarray) -> np.ndarray:
    """Distances [n] in px between joints seen and the triangulated joints projected, over views and known joints.

    Args:
        rig: the cameras.
        joints2d: [V, J, 3] (u, v, score), score 0 = unknown.
        joints3d: [J, 4] (x, y, z, score), world metres, score 0 = unknown.

    Large where the calibration is off, where cameras are not in step, and where the detector errs.
    """
    found = []
    for v in range(len(rig)):
        known = (joints2d[v, :, 2] > 0) & (joints3d[:, 3] > 0)
        pixels, z = project(joints3d[known, :3], rig.intrinsics[v], rig.world_to_camera[v])
        found.append(np.linalg.norm(pixels - joints2d[v, known, :2], axis=1)[z > 0])
    return np.concatenate(found) if found else np.zeros(0)


def photometric_disagreement(
    rig: Rig, views: tuple[int, int], colors: tuple[np.ndarray, np.ndarray], depths: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Differences [n] in 1/255, mean over RGB, between what two views show at the points that both see.

    Args:
        rig: the cameras.
        views: the two views.
        colors: their pictures, [h, w, 3] uint8.
        depths: their depths, [h, w] metres, 0 = none.

    A point of the first view is seen by the second when the second's depth there is within 1 % of its own.
    Large where exposure or calibration disagree, and where the depth is wrong.
    """
    first, second = views
    surface = depths[0] > 0
    points = unproject(depths[0].astype(np.float64), rig.intrinsics[first], rig.world_to_camera[first])[surface]
    pixels, z = project(points, rig.intrinsics[second], rig.world_to_camera[second])
    at = points_to_integer_centres(pixels).astype(np.float32)
    inside = (z > 0) & (at >= -0.5).all(axis=1) & (at <= np.array(depths[1].shape[::-1]) - 0.5).all(axis=1)
    seen = _sample(depths[1], at, cv2.INTER_NEAREST)
    same = inside & (seen > 0) & (np.abs(seen - z) <= SAME_SURFACE * z)
    there = _sample(colors[1], at, cv2.INTER_LINEAR)
    return np.abs(there[same] - colors[0][surface][same].astype(np.float32)).mean(axis=1)


def typical_offset(change: np.ndarray) -> float:
    """Px by which an outline lies outside (+) or inside (-) the picture's own edge, of `change_across` [n, K], n > 0:
    where its points have most of their change together.

    Cloth changes, too, and a wall mostly does not, so that the mean position of a point's change lies inside the
    subject: of exact masks by 0.2 px of a person 450 px tall, and by 1.3 of one 130 px tall in a chequered shirt. But
    it changes at another place at every point, and the edge is at the same one: the mean position of what changes
    there, and half a px to both sides.
    """
    mean = change.mean(axis=0)
    top = int(mean.argmax())
    there = slice(max(top - 1, 0), top + 2)
    return float(mean[there] @ OFFSETS[there] / mean[there].sum())


def change_across(color: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """How much of the colour's change across a mask's outline is where, [n, K] float32, each of n points' summing to 1;
    the K places are OFFSETS.

    Args:
        color: [h, w, 3] uint8.
        mask: [h, w] uint8, the outline is where it crosses 127.5.

    Along the outline's normal, within REACH px. Where the colour changes by less than EDGE there is no edge and no
    value, and none where the subject or the gap beside it is narrower than that.
    """
    inside = foreground(mask)
    # Signed distance to the outline, at pixel centres: positive outside.
    distance = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5) - cv2.distanceTransform(
        inside.astype(np.uint8), cv2.DIST_L2, 5
    )
    distance += np.where(inside, 0.5, -0.5).astype(np.float32)
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    slope = np.stack(
        [cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)], axis=-1
    )
    rows, columns = np.nonzero(inside & (distance > -1))
    normal = slope[rows, columns] / np.maximum(np.linalg.norm(slope[rows, columns], axis=1, keepdims=True), 1e-6)
    # The pixels found lie half a pixel inside the outline.
    start = np.stack([columns, rows], axis=1).astype(np.float32) - distance[rows, columns][:, None] * normal
    # Thin limbs and narrow gaps have a second edge within reach, which would be taken for a part of the first.
    ends = [_sample(smooth, start + side * REACH * normal, cv2.INTER_LINEAR) for side in (-1, 1)]
    clear = (ends[0] <= -CLEAR * REACH) & (ends[1] >= CLEAR * REACH)
    at = start[clear][:, None] + STEPS[None, :, None] * normal[clear][:, None]
    profile = _sample(color, at.reshape(-1, 2), cv2.INTER_LINEAR).reshape(*at.shape[:2], 3)
    change = np.linalg.norm(np.diff(profile, axis=1), axis=2) ** 2
    there = np.sqrt(change.max(axis=1)) >= EDGE
    return np.asarray(change[there] / change[there].sum(axis=1, keepdims=True))


def _sample(picture: np.ndarray, points: np.ndarray, interpolation: int) -> np.ndarray:
    """[n, ...] float32 values of a picture [h, w, ...] at points [n, 2] with integer centres, the nearest edge's
    outside.

    OpenCV takes maps of fewer than 32767 columns.
    """
    count, width = len(points), 4096
    grid = np.zeros((-(-count // width) * width, 2), np.float32)
    grid[:count] = np.clip(points, -1e6, 1e6)
    rows = grid.reshape(-1, width, 2)
    if not count:
        return np.zeros((0, *picture.shape[2:]), np.float32)
    values = cv2.remap(
        picture.astype(np.float32), rows[..., 0], rows[..., 1], interpolation, borderMode=cv2.BORDER_REPLICATE
    )
    return values.reshape(-1, *picture.shape[2:])[:count]
