"""Image-based rendering: the source pictures themselves, blended over the visual hull by angle and visibility.

The target's rays meet the hull of the source masks; the point is looked up in every source picture that sees it, and
the pictures nearest in angle are blended so that each fades out before another takes its place (Buehler et al.,
"Unstructured Lumigraph Rendering", 2001). Nothing is kept from one target camera to the next: a picture a view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import project, rays, unproject
from posegaussian.stages.rendering.clipping import cover
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import points_from_integer_centres, points_to_integer_centres

BLENDED = 4
"""Source pictures that make a pixel, at most."""
BEHIND = 0.01
"""Share of a point's distance by which it may lie behind the surface that a source view has there, and still be seen:
25 mm at 2.5 m, about what the hull errs by where it is cut square."""
MARGIN = 1.05
"""Radius of the sphere in which the hull is looked for, over that of the one around the surfaces the photos see: near
the cameras too few views look for the masks to carve what is none of the subject."""
SMALLEST = 1e-3
"""Radians below which angles count as equal: a source camera in the place of the target's is taken alone."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One source picture."""

    camera: Camera
    color: np.ndarray
    """[h, w, 3] uint8, as filmed."""
    mask: np.ndarray
    """[h, w] uint8 0..255."""
    depth: np.ndarray
    """[h, w] float32 metres along the optical axis of the surface that the view sees; 0 where there is none."""


def around(silhouettes: Silhouettes, photos: Sequence[Photo]) -> Silhouettes:
    """The silhouettes, their hull looked for only around the surfaces that the photos see."""
    seen = [
        unproject(p.depth, np.asarray(p.camera.intrinsics), np.asarray(p.camera.world_to_camera))[p.depth > 0]
        for p in photos
    ]
    points = np.concatenate(seen) if seen else np.zeros((0, 3))
    if not len(points):
        return silhouettes
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = MARGIN * float(np.linalg.norm(points - centre, axis=1).max())
    return replace(silhouettes, centre=centre, radius=min(radius, silhouettes.radius))


def blended(camera: Camera, silhouettes: Silhouettes, photos: Sequence[Photo]) -> tuple[np.ndarray, np.ndarray]:
    """Colour [h, w, 3] float32 sRGB 0..1, premultiplied on black, and alpha [h, w] float32 of the target camera.

    Alpha is what the masks' soft edges leave of the hull; a pixel of it that no photo shows, or whose ray misses the
    hull, is empty. Where a point is hidden from every photo it is taken from those nearest in angle all the same.
    """
    shape = (camera.height, camera.width)
    alpha = cover(silhouettes, camera, np.ones(shape, bool)) if silhouettes.views else np.zeros(shape, np.float32)
    rows, columns = np.nonzero(alpha > 0)
    pixels = points_from_integer_centres(np.stack([columns, rows], axis=-1))
    origin, directions = rays(pixels, np.asarray(camera.intrinsics), np.asarray(camera.world_to_camera))
    near = silhouettes.ends(origin, directions)[:, 0]
    points = origin + near[:, None] * directions
    looks = [_look(photo, points, rows, columns, shape) for photo in photos]
    out, shown = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    if looks and len(rows):
        color, found = _mixed(looks, [_angle(origin, p.camera.centre, points) for p in photos])
        found &= near > 0
        shown[rows, columns] = np.where(found, alpha[rows, columns], 0)
        out[rows, columns] = color * shown[rows, columns][:, None]
    return out, shown


@dataclass(frozen=True, eq=False)
class _Look:
    """What one photo shows of N points."""

    color: np.ndarray  # [N, 3]
    """sRGB 0..1."""
    cover: np.ndarray  # [N]
    """Share 0..1 of the subject in it; 0 beyond the picture and behind the camera."""
    seen: np.ndarray  # [N]
    """bool: nothing the photo shows lies before the point."""


def _look(photo: Photo, points: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> _Look:
    """Points [N, 3] belong to the target's pixels (rows, columns) of a picture of `shape`, which lookups are made in:
    a list of points is too long for OpenCV."""
    pose, k = np.asarray(photo.camera.world_to_camera), np.asarray(photo.camera.intrinsics)
    pixels, z = project(points, k, pose)
    at = np.full((*shape, 2), -2.0, np.float32)
    inside = (z > 0) & np.isfinite(pixels).all(axis=1)
    at[rows[inside], columns[inside]] = points_to_integer_centres(pixels[inside])
    soft = (photo.mask / np.float32(255)).astype(np.float32)

    def sampled(values: np.ndarray, how: int) -> np.ndarray:
        found = cv2.remap(values, at, None, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)  # type: ignore[call-overload]
        return np.asarray(found[rows, columns])

    covered = sampled(soft, cv2.INTER_LINEAR)
    # What stands behind the subject is no colour of it: at its rim the mask says how much of each is there.
    color = sampled(photo.color.astype(np.float32) / 255 * soft[..., None], cv2.INTER_LINEAR)
    surface = sampled(photo.depth.astype(np.float32), cv2.INTER_NEAREST)
    seen = (surface > 0) & (z <= surface * (1 + BEHIND))
    return _Look(color / np.maximum(covered, 1e-3)[:, None], covered, seen)


def _angle(target: np.ndarray, source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """[N] radians at each point [N, 3] between the two cameras."""
    a, b = target - points, source - points
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))


def _mixed(looks: Sequence[_Look], angles: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """[N, 3] colour and [N] bool, whether any photo shows the point.

    A weight is the share that is left of the angle to the first photo left out, over the angle: none jumps where
    another one becomes the nearer.
    """
    shown = np.stack([look.cover > 0 for look in looks])
    seen = np.stack([look.seen for look in looks]) & shown
    usable = np.where(seen.any(axis=0), seen, shown)
    angle = np.where(usable, np.maximum(np.stack(angles), SMALLEST), np.inf)
    limit = np.sort(angle, axis=0)[BLENDED] if len(looks) > BLENDED else np.full(angle.shape[1], np.inf)
    limit = np.where(np.isfinite(limit), limit, np.pi + SMALLEST)
    weight = np.where(usable, np.maximum(0, 1 - angle / limit) / angle, 0) * np.stack([look.cover for look in looks])
    total = weight.sum(axis=0)
    color = sum(w[:, None] * look.color for w, look in zip(weight, looks, strict=True))
    return np.asarray(color) / np.where(total > 0, total, 1)[:, None], total > 0
