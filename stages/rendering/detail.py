"""Detail of a drawn picture, looked up in the source pictures where its surface lies.

Gaussians blur: each is as wide as its pixel, what lies in front of its neighbours by a hair covers them, and the few
that refinement moves are wider still. A drawn picture looks like a photograph that was blurred by half a pixel. But it
tells where the surface lies, and there the source pictures can be looked up as sharp as they are, as in image-based
rendering (Buehler et al., "Unstructured lumigraph rendering", 2001). Where what is found differs from what is drawn the
surface, or the light on it, is another one, and the drawn colour stays.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, project, rays
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.rendering.lift import GaussianMaps
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import camera_centre, points_to_integer_centres

SHARE = 0.65
"""Of what is looked up in a pixel's colour, where it is what is drawn. With 0.8 and 0.9 eight tuning people have 0.01
dB more on the mean and less SSIM; a larger share the nearer a source camera stands gains nothing."""
UNLIKE = 25 / 255
"""Difference from what is drawn, root of the mean square of the channels, at which that share is exp(-1/2) of it."""
SURFACE = 0.005
"""Share of its depth by which a view's surface may lie beside a point that the view still sees."""
ASIDE = 0.2
"""Chord of the angle between a view's ray and the picture's at which a view weighs a sixteenth of one in line. With a
tenth of it an uneven rig of sixteen cameras has 0.10 dB less, even ones as much."""
FADE = (0.5, 0.9)
"""Alpha from which on a pixel is surface beside its outline, and from which on wholly."""
INSIDE = 250
"""Mask from which on a pixel's colour holds no background."""


@dataclass(frozen=True, eq=False)
class SourcePicture:
    """One frame of one source view, to look colours up in."""

    color: np.ndarray
    """[h, w, 3] float32 sRGB 0..1."""
    depth: np.ndarray
    """[h, w] float32 metres, 0 where there is no Gaussian."""
    inside: np.ndarray
    """[h, w] float32, 1 where a pixel shows the subject alone."""
    intrinsics: np.ndarray
    """[3, 3] px."""
    world_to_camera: np.ndarray
    """[4, 4]."""

    @classmethod
    def of(
        cls, maps: GaussianMaps, intrinsics: np.ndarray, world_to_camera: np.ndarray, mask: np.ndarray
    ) -> SourcePicture:
        """From the maps that Gaussians are lifted from, and the view's mask [h, w] uint8."""
        color = np.asarray(maps.color, np.float32) / np.float32(255)
        inside = (mask >= INSIDE).astype(np.float32)
        there = np.asarray(maps.opacity[0]) > 0
        for values in (maps.depth, *maps.scale, *maps.normal, *maps.opacity):  # what is not finite draws nothing either
            there &= np.isfinite(values)
        depth = np.where(there, maps.depth, 0).astype(np.float32)
        return cls(color, depth, inside, intrinsics, world_to_camera)

    def averaged(self, ratio: float) -> SourcePicture:
        """As a camera looks it up whose pixels are `ratio` of its own wide: over them, by a Gaussian of the variance
        that a box of so many pixels has more than one of them. Amid the subject is what is so in all of it."""
        if ratio <= 1:
            return self
        sigma = float(np.sqrt((ratio**2 - 1) / 12))
        color, inside = (
            cv2.GaussianBlur(m, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE) for m in (self.color, self.inside)
        )
        return replace(self, color=color, inside=inside)

    @property
    def centre(self) -> np.ndarray:
        """[3] world metres."""
        return camera_centre(self.world_to_camera)

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours [h, w, 3] of world points [h, w, 3], and whether they are seen [h, w]: where the view's surface
        passes, amid the subject."""
        place, z = project(points, self.intrinsics, self.world_to_camera)
        place = np.where(z[..., None] > 0, place, -2)  # beside the picture
        u, v = np.moveaxis(points_to_integer_centres(place).astype(np.float32), -1, 0)
        u, v = (np.ascontiguousarray(m) for m in (u, v))
        depth = cv2.remap(self.depth, u, v, cv2.INTER_NEAREST)
        inside = cv2.remap(self.inside, u, v, cv2.INTER_LINEAR)
        color = cv2.remap(self.color, u, v, cv2.INTER_CUBIC)
        seen = (depth > 0) & (np.abs(depth - z) < SURFACE * depth) & (inside > 0.99)
        return color, seen


def detailed(
    color: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    sources: Iterable[tuple[SourcePicture, float]],
) -> np.ndarray:
    """Color [h, w, 3] float32, premultiplied, of a picture drawn with alpha [h, w], with the detail that the source
    pictures have where its surface lies: depth [h, w] metres, 0 = unknown.

    `sources` come with weights 0..1, which fade as the camera moves (`posegaussian.stages.rendering.sources.choose`). A
    pixel that none of them sees stays as it is.
    """
    surface = (depth > 0) & np.isfinite(depth) & (alpha > FADE[0])
    if not surface.any():
        return color
    part = part_around(surface, 0)
    k, pose = (np.asarray(m, np.float64) for m in (camera.intrinsics, camera.world_to_camera))
    origin, directions = rays(pixel_centres((camera.width, camera.height))[part], k, pose)
    points = origin + directions * np.where(surface, depth, 1)[part][..., None]
    towards = _unit(origin - points)
    total, weights = np.zeros(color[part].shape, np.float32), np.zeros(alpha[part].shape, np.float32)
    for source, weight in sources:
        found, seen = source.at(points)
        apart = np.linalg.norm(_unit(source.centre - points) - towards, axis=-1)
        w = (seen * (weight / (apart / ASIDE + 1) ** 4)).astype(np.float32)
        total += w[..., None] * found
        weights += w
    known = surface[part] & (weights > 0)
    found = np.clip(total / np.where(known, weights, 1)[..., None], 0, 1)  # bicubic sampling overshoots
    change = found - color[part] / np.where(surface, alpha, 1)[part][..., None]
    unlike = np.square(change).mean(axis=-1) / UNLIKE**2
    share = SHARE * np.exp(-unlike / 2) * np.interp(alpha[part], FADE, (0, 1))
    out = color.copy()
    out[part] += np.where(known, share * alpha[part], 0)[..., None].astype(np.float32) * change
    return out


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
