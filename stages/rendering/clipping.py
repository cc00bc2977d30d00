"""What the source masks say about a rendered picture:
its soft silhouette, nothing beyond it, no small holes within it, and an outline like theirs."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.rendering.evening import REACH, Outlines
from posegaussian.stages.silhouettes.hull import (
    MOST_POINTS,
    WITNESSES,
    Silhouettes,
    beside,
    clip_ray,
    in_sphere,
    into_views,
)
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import points_from_integer_centres

HOLE = 3 / 512
"""Half the root of the area of the largest hole that is filled, over the longer side of the picture: 36 px at 512.
Larger ones are as often the background between an arm and the body. Two simulated people, eight cameras: box PSNR
+0.4 and +0.7 dB with clipping; four times the area: -0.5 and +0.7."""
CRACK = 2.4 / 512
"""Half the width of the widest crack that is filled, however long, over the longer side of the picture: 4 px at 512.
Simulated people, `bust`: box PSNR +0.14 and +0.02 dB, others 0; a quarter wider costs 0.2 dB between an arm and the
body."""
FINE = 0.5
"""Px between points of a ray near a silhouette."""


def cover(silhouettes: Silhouettes, camera: Camera, wanted: np.ndarray) -> np.ndarray:
    """[h, w] float32 share 0..1 of each `wanted` [h, w] bool pixel that the hull of the silhouettes covers; 1 where not
    wanted.

    The largest share, along the pixel's ray, of what every mask that sees the point leaves of it: the masks' soft edges
    carry over. A point that fewer than two see is none of the hull's, as in `posegaussian.stages.silhouettes.hull`. 1
    everywhere without silhouettes.
    """
    out = np.ones(wanted.shape, np.float32)
    rows, columns = np.nonzero(wanted)
    if silhouettes.views and len(rows):
        pixels = points_from_integer_centres(np.stack([columns, rows], axis=-1))
        origin, directions = rays(pixels, np.asarray(camera.intrinsics), np.asarray(camera.world_to_camera))
        s = silhouettes
        out[rows, columns] = _cover(
            origin,
            directions,
            s.distance,
            s.projections,
            s.boxes,
            s.sizes,
            s.focals,
            s.centre,
            s.radius,
            FINE * s.pixel,
        )
    return out


@njit(cache=True, nogil=True)
def _cover(
    origin: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    projections: np.ndarray,
    boxes: np.ndarray,
    sizes: np.ndarray,
    focals: np.ndarray,
    centre: np.ndarray,
    radius: float,
    step: float,
) -> np.ndarray:
    """[N] float32 of rays [N, 3]; `step` metres."""
    count = projections.shape[0]
    out = np.zeros(len(directions), np.float32)
    start, along, order = np.empty((count, 3)), np.empty((count, 3)), np.arange(count)
    for n in range(len(directions)):
        d = directions[n]
        into_views(origin, d, projections, start, along)
        for v in range(count):
            order[v] = v  # a ray's points must not depend on the rays before it
        first, last = in_sphere(origin - centre, d, radius)
        z, last = clip_ray(start, along, boxes, sizes, first, last) if first < last else (first, last)
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        best = 0.0
        for _ in range(int(MOST_POINTS / FINE)):  # a step that is lost in z's rounding would never end
            if not z <= last or best >= 1:
                break
            seen, share, free = 0, 1.0, step
            for k in range(count):
                v = order[k]
                px, edge, w = beside(z, v, start, along, distance, sizes)
                if px == -np.inf:
                    continue
                seen += 1
                share = min(share, 0.5 - px)
                if share <= best:
                    px = min(0.9 * (px - 0.5), edge)
                    free = max(free, px * w / (focals[v] + px)) if px > 0 else free
                    order[k], order[0] = order[0], v
                    break
            if share > best and seen >= min(WITNESSES, count):
                best = share
            z += free / length
        out[n] = min(best, 1.0)
    return out


def clipped(color: np.ndarray, alpha: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] with no more alpha than is `covered` [h, w]; float32."""
    less = np.minimum(alpha, covered)
    return (color * (less / np.where(alpha > 0, alpha, 1))[..., None]).astype(np.float32), less.astype(np.float32)


def filled(color: np.ndarray, alpha: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] with small holes, and what shines through inside, closed up to
    what is `covered` [h, w]; float32.

    A hole is a small or thin patch of less than half alpha that the opaque part surrounds: what is open to the
    background may be background. It takes the mean colour of its surroundings, weighted by alpha and nearness; an
    opaque pixel without a transparent neighbour keeps its own.
    """
    size, solid = 2 * HOLE * max(alpha.shape), alpha > 0.5
    hole = _holes(solid)
    inner = cv2.erode((solid | hole).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    nearby, weight = (cv2.GaussianBlur(a.astype(np.float32), (0, 0), max(size / 4, 0.5)) for a in (color, alpha))
    more = np.where(hole | (inner & solid), np.maximum(covered - alpha, 0), 0) * (weight > 1e-3)
    own = color / np.where(solid, alpha, 1)[..., None]
    around = nearby / np.maximum(weight, 1e-3)[..., None]
    return (color + more[..., None] * np.where(solid[..., None], own, around)).astype(np.float32), (
        alpha + more
    ).astype(np.float32)


def _holes(solid: np.ndarray) -> np.ndarray:
    """[h, w] bool: patches that the opaque part `solid` [h, w] surrounds and that are small or thin."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats((~solid).astype(np.uint8), connectivity=8)
    x, y, w, h, area = (statistics[:, i] for i in range(5))
    enclosed = (x > 0) & (y > 0) & (x + w < solid.shape[1]) & (y + h < solid.shape[0])
    within = enclosed[labels] & ~solid
    width, longer = np.zeros(len(statistics)), max(solid.shape)
    np.maximum.at(width, labels[within], cv2.distanceTransform((~solid).astype(np.uint8), cv2.DIST_L2, 5)[within])
    return within & ((area <= (2 * HOLE * longer) ** 2) | (width <= CRACK * longer))[labels]


def retouched(
    color: np.ndarray,
    alpha: np.ndarray,
    silhouettes: Silhouettes,
    camera: Camera,
    fill: bool,
    outlines: Outlines | None,
    clip: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] of a rendered picture with holes filled, then its outline evened
    like the `outlines` given, then clipped, as told; float32.

    The cover is asked for where there is some alpha, and as far around it as holes and evening reach.
    """
    covered = np.ones(alpha.shape, np.float32)
    if fill or clip:
        radius = max(REACH, round(HOLE * max(alpha.shape)))
        wanted = cv2.dilate((alpha > 0).astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) > 0
        covered = cover(silhouettes, camera, wanted)
    if fill:
        color, alpha = filled(color, alpha, covered)
    if outlines is not None:
        color, alpha = outlines.evened(color, alpha)
    return clipped(color, alpha, covered) if clip else (color.astype(np.float32), alpha.astype(np.float32))
