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
import torch

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.rendering.lift import GaussianMaps, positive
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import camera_centre, points_from_integer_centres, to_integer_centres

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
BESIDE, NEARER = 3, 0.02
"""Px about a pixel within which a surface that is nearer, by this share of its depth, may have a part in its colour:
depth ends a pixel or two beside where colours do, and outlines of hands and straps were looked up as dots on what lies
behind them. *desk* 17.750 / .5025 -> 17.771 / .5056, `bust` 30.072 / .9099 -> 30.061 / .9102; by a share of 0.01
17.772 / .5061 and 30.040 / .9098, within 2 px by 0.02 17.766 / .5048 and 30.066 / .9102."""


@dataclass(frozen=True, eq=False)
class SourcePicture:
    """One frame of one source view, to look colours up in."""

    color: np.ndarray
    """[h, w, 3] float32 sRGB 0..1."""
    depth: np.ndarray
    """[h, w] float32 metres, 0 where there is no Gaussian."""
    inside: np.ndarray
    """[h, w] float32, 1 where a pixel shows the surface at its depth alone, nothing beside or before it."""
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
        depth, (given, *others) = (
            np.zeros(mask.shape, np.float32),
            (np.asarray(a) for a in (maps.depth, *maps.scale, *maps.normal, *maps.opacity)),
        )
        there = np.flatnonzero(positive(torch.as_tensor(maps.opacity[0])))
        finite = np.ones(len(there), bool)
        for values in (given, *others):  # what is not finite draws nothing either
            finite &= np.isfinite(values.reshape(-1)[there])
        depth.reshape(-1)[there] = np.where(finite, given.reshape(-1)[there], 0)
        inside = ((mask >= INSIDE) & ~_behind(depth)).astype(np.float32)
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

    @property
    def projection(self) -> np.ndarray:
        """[3, 4] world metres to homogeneous px, integer centres."""
        return np.asarray(to_integer_centres(self.intrinsics) @ self.world_to_camera[:3])

    def at(self, u: np.ndarray, v: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours [h, w, 3] at pixels u, v [h, w] float32, integer centres, and whether points that lie there at depth
        z [h, w] m are seen [h, w]: where the view's surface passes, amid the subject."""
        depth = cv2.remap(self.depth, u, v, cv2.INTER_NEAREST)
        inside = cv2.remap(self.inside, u, v, cv2.INTER_LINEAR)
        color = cv2.remap(self.color, u, v, cv2.INTER_CUBIC)
        return color, (depth > 0) & (np.abs(depth - z) < SURFACE * depth) & (inside > 0.99)


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
    left, top = part[1].start, part[0].start
    first = points_from_integer_centres(np.array([[left, top], [left + 1, top], [left, top + 1]]))
    origin, steps = rays(first, k, pose)
    total, weights = np.zeros(color[part].shape, np.float32), np.zeros(alpha[part].shape, np.float32)
    for source, weight in sources:
        u, v, z, weight_of = _places(
            surface[part], depth[part], origin, steps, source.projection, source.centre, weight
        )
        _add(total, weights, *source.at(u, v, z), weight_of)
    out = color.copy()
    _mix(out[part], alpha[part], total, weights)
    return out


def _behind(depth: np.ndarray) -> np.ndarray:
    """[h, w] bool, of depth [h, w] m, 0 = none: where a nearer surface lies within `BESIDE` px."""
    known = np.where(depth > 0, depth, np.float32(np.inf))
    nearest = cv2.erode(known, np.ones((2 * BESIDE + 1, 2 * BESIDE + 1), np.uint8), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(nearest < (1 - NEARER) * depth)


@compiled(error_model="numpy")
def _places(
    surface: np.ndarray,
    depth: np.ndarray,
    origin: np.ndarray,
    steps: np.ndarray,
    projection: np.ndarray,
    centre: np.ndarray,
    weight: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where a source camera sees the points of a picture's `surface` [h, w] bool: u and v [h, w] float32 px, integer
    centres, -2 elsewhere; their depth there [h, w] m; and what the camera weighs at them [h, w] float32.

    depth [h, w] m of the picture; origin [3] of its rays in the world, and steps [3, 3] their directions in the first
    pixel, the one beside it and the one below. projection [3, 4], centre [3] and weight of the source.
    """
    u, v = np.full(surface.shape, -2.0, np.float32), np.full(surface.shape, -2.0, np.float32)
    z, weights = np.zeros(surface.shape, np.float32), np.zeros(surface.shape, np.float32)
    place = np.empty(3)
    for row in range(surface.shape[0]):
        for column in range(surface.shape[1]):
            if not surface[row, column]:
                continue
            place[:] = projection[:, 3]
            own, other, both = 0.0, 0.0, 0.0
            for i in range(3):
                ray = steps[0, i] + column * (steps[1, i] - steps[0, i]) + row * (steps[2, i] - steps[0, i])
                point = origin[i] + depth[row, column] * ray
                here, there = origin[i] - point, centre[i] - point
                own, other, both = own + here * here, other + there * there, both + here * there
                for j in range(3):
                    place[j] += projection[j, i] * point
            if place[2] > 0:
                u[row, column], v[row, column] = place[0] / place[2], place[1] / place[2]
                z[row, column] = place[2]
                cosine = both / max(np.sqrt(own * other), 1e-24)
                weights[row, column] = weight / (np.sqrt(max(2 - 2 * cosine, 0.0)) / ASIDE + 1) ** 4
    return u, v, z, weights


@compiled(error_model="numpy")
def _add(total: np.ndarray, weights: np.ndarray, found: np.ndarray, seen: np.ndarray, weight: np.ndarray) -> None:
    """Add to total [h, w, 3] and weights [h, w] the colours [h, w, 3] that a source has found, where they are seen [h,
    w] bool, by their weight [h, w]."""
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            if seen[row, column]:
                w = weight[row, column]
                weights[row, column] += w
                for i in range(3):
                    total[row, column, i] += w * found[row, column, i]


@compiled(error_model="numpy")
def _mix(color: np.ndarray, alpha: np.ndarray, total: np.ndarray, weights: np.ndarray) -> None:
    """Mix into color [h, w, 3], premultiplied by alpha [h, w], the mean of what was found, where there is any: colours
    total [h, w, 3] over weights [h, w]."""
    change = np.empty(3)
    for row in range(color.shape[0]):
        for column in range(color.shape[1]):
            if not weights[row, column] > 0:
                continue
            a, unlike = alpha[row, column], 0.0
            for i in range(3):
                found = min(max(total[row, column, i] / weights[row, column], 0.0), 1.0)  # bicubic sampling overshoots
                change[i] = found - color[row, column, i] / a
                unlike += change[i] * change[i] / (3 * UNLIKE * UNLIKE)
            whole = min(max((a - FADE[0]) / (FADE[1] - FADE[0]), 0.0), 1.0)
            share = SHARE * np.exp(-0.5 * unlike) * whole
            for i in range(3):
                color[row, column, i] += share * a * change[i]
