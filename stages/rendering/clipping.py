"""What the source masks say about a rendered picture:
its soft silhouette, nothing beyond it, no small holes within it, and an outline like theirs."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.rendering.evening import REACH, Outlines
from posegaussian.stages.silhouettes.coverage import coverage, covered_around
from posegaussian.stages.silhouettes.hull import Silhouettes
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
UNSURE = 0.003
"""How far estimated masks may end within the subject, over the longer side of a source picture: 3 px at 960. What lies
farther beyond their hull is a stray piece; nearer to it clipping may take what a mask lacks (two simulated people in a
room, six cameras: box PSNR -0.49 and +0.05 dB)."""
SOFT = (1.2, 1.6)
"""Px over which mattes rise (`posegaussian.stages.silhouettes.softness`) up to which they say where an outline is, and
from which on they are unsure: exact masks have 0.5 to 0.7, mattes that are 1.5 px soft 1.3 to 1.4, and 2 px 1.5 to
2.1."""
SPARED = 0.5
"""Px beyond soft given mattes from which on a refined picture is clipped. Within their outlines mattes leave only a
part of a pixel, and the least of what many views leave is too little, where refined Gaussians already have the mattes'
own softness. Box PSNR against exact outlines, and against outlines as soft as the mattes: people like captures, 320 px,
seeds 2, 6 and 8 (6, 8 and 16 cameras) +0.08, +0.04, +0.61 and 0.00, 0.00, +0.12 dB; unrefined pictures +0.03, -0.01,
+0.71 and -0.14, -0.22, -0.43, so these stay clipped."""
BLOCK = 8
"""Px of a block's side: of most blocks of a subject all pixels are covered, and told at once."""


def cover(
    silhouettes: Silhouettes,
    camera: Camera,
    wanted: np.ndarray,
    enough: np.ndarray | None = None,
    corner: tuple[int, int] = (0, 0),
    depth: np.ndarray | None = None,
) -> np.ndarray:
    """[h, w] float32 share 0..1 of each `wanted` [h, w] bool pixel that the hull of the silhouettes covers; 1 where not
    wanted.

    See `posegaussian.stages.silhouettes.coverage`. 1 everywhere without silhouettes. Of a pixel whose share reaches
    what is `enough` [h, w] for it, that is all that is said. `wanted` may be a part of the picture; its first pixel is
    in row and column `corner`. Of a pixel at about whose `depth` [h, w] metres, 0 = unknown, there is some surface
    nearly the same is said, sooner.
    """
    out = np.ones(wanted.shape, np.float32)
    if not silhouettes.views or not wanted.any():
        return out
    k, pose = np.asarray(camera.intrinsics), np.asarray(camera.world_to_camera)
    held, first = _held(wanted), np.array(corner[::-1])
    blocks = np.stack(np.nonzero(held)[::-1], axis=-1)
    middles = points_from_integer_centres(first + blocks * BLOCK + 0.5 * (BLOCK - 1))
    settled, guess = np.zeros(held.shape, bool), np.zeros(held.shape)
    settled[held], guess[held] = covered_around(silhouettes, *rays(middles, k, pose), 0.5 * (BLOCK - 1) * _diagonal(k))
    rows, columns = np.nonzero(wanted & ~_spread(settled, wanted.shape))
    pixels = points_from_integer_centres(first + np.stack([columns, rows], axis=-1))
    out[rows, columns] = coverage(
        silhouettes,
        *rays(pixels, k, pose),
        guess[rows // BLOCK, columns // BLOCK],
        np.zeros(len(rows)) if depth is None else depth[rows, columns].astype(np.float64),
        np.ones(len(rows)) if enough is None else enough[rows, columns].astype(np.float64),
    )
    return out


def beside(softness: float) -> float:
    """Px beyond given mattes of that softness from which on a refined picture is clipped."""
    return SPARED * min(max((softness - SOFT[0]) / (SOFT[1] - SOFT[0]), 0.0), 1.0)


def _diagonal(intrinsics: np.ndarray) -> float:
    """Length of a pixel's diagonal at a depth of 1, at most."""
    across = np.linalg.inv(intrinsics)[:2, :2]
    return float(max(np.linalg.norm(across @ [1, 1]), np.linalg.norm(across @ [1, -1])))


def _held(wanted: np.ndarray) -> np.ndarray:
    """[ceil(h / BLOCK), ceil(w / BLOCK)] bool: blocks that hold a wanted [h, w] pixel."""
    height, width = wanted.shape
    rows = np.logical_or.reduceat(wanted, range(0, height, BLOCK), axis=0)
    return np.asarray(np.logical_or.reduceat(rows, range(0, width, BLOCK), axis=1))


def _spread(blocks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """[h, w] each block's value at its pixels."""
    return np.repeat(np.repeat(blocks, BLOCK, axis=0)[: shape[0]], BLOCK, axis=1)[:, : shape[1]]


def clipped(color: np.ndarray, alpha: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] with no more alpha than is `covered` [h, w]; float32."""
    less = np.minimum(alpha, covered)
    return (color * (less / np.where(alpha > 0, alpha, 1))[..., None]).astype(np.float32), less.astype(np.float32)


class Fillable(NamedTuple):
    """What may be closed of a picture, or of a part of it that holds all of its alpha."""

    hole: np.ndarray
    """[h, w] bool: small or thin patches of less than half alpha that the opaque part surrounds: what is open to the
    background may be background."""
    inside: np.ndarray
    """[h, w] bool: what is solid, and so is, or will be, all around it."""

    @classmethod
    def of(cls, alpha: np.ndarray, longer: int) -> Fillable:
        """Of alpha [h, w] of a picture whose `longer` side is so many px."""
        solid = alpha > 0.5
        hole = _holes(solid, longer)
        # What is solid at the picture's border goes on beyond it.
        inside = cv2.erode((solid | hole).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
        return cls(hole, inside & solid)

    @property
    def some(self) -> np.ndarray:
        """[h, w] bool: either."""
        return np.asarray(self.hole | self.inside)


def filled(
    color: np.ndarray, alpha: np.ndarray, where: Fillable, covered: np.ndarray, longer: int, lit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] closed up to what is `covered` [h, w]; float32.

    A hole takes the mean colour of its surroundings, weighted by alpha and nearness. An opaque pixel without a
    transparent neighbour keeps its own, and becomes as much brighter as it becomes more opaque with `lit` of 1; with 0
    its light stays: Gaussians that were trained on black make up by their colours for what they lack in opacity.
    """
    wide, (out, opaque) = _nearby(longer), (a.astype(np.float32) for a in (color, alpha))
    weight = cv2.GaussianBlur(opaque, (0, 0), wide)
    at = np.nonzero(where.some & (covered > alpha) & (weight > 1e-3))
    if not len(at[0]):
        return out, opaque
    own, shown, hole = color[at], alpha[at], where.hole[at]
    solid, more = shown > 0.5, covered[at] - shown
    light = more * np.where(hole, 1, np.float32(lit))
    around = cv2.GaussianBlur(out, (0, 0), wide)[at] / weight[at][:, None]
    own = own / np.where(solid, shown, 1)[:, None]
    out[at] = color[at] + light[:, None] * np.where(solid[:, None], own, around)
    opaque[at] = shown + more
    return out, opaque


def _nearby(longer: int) -> float:
    """Px: standard deviation of what is near a hole."""
    return max(HOLE * longer / 2, 0.5)


def _holes(solid: np.ndarray, longer: int) -> np.ndarray:
    """[h, w] bool: patches that the opaque part `solid` [h, w] surrounds and that are small or thin."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats((~solid).astype(np.uint8), connectivity=8)
    x, y, w, h, area = (statistics[:, i] for i in range(5))
    enclosed = (x > 0) & (y > 0) & (x + w < solid.shape[1]) & (y + h < solid.shape[0])
    within = enclosed[labels] & ~solid
    width = np.zeros(len(statistics))
    np.maximum.at(width, labels[within], cv2.distanceTransform((~solid).astype(np.uint8), cv2.DIST_L2, 5)[within])
    return within & ((area <= (2 * HOLE * longer) ** 2) | (width <= CRACK * longer))[labels]


def retouched(
    color: np.ndarray,
    alpha: np.ndarray,
    silhouettes: Silhouettes,
    camera: Camera,
    lit: float | None,
    outlines: Outlines | None,
    bounds: Silhouettes | None,
    depth: np.ndarray | None = None,
    sharp: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Color [h, w, 3], premultiplied, and alpha [h, w] of a rendered picture with holes filled, then its outline evened
    like the `outlines` given, then clipped, then its outline sharpened, as told; float32.

    `lit`: how much brighter what is made more opaque becomes, see `filled`; None: nothing is filled. The cover is asked
    for where it decides about something: within, as far as that is not opaque, and of what is drawn at last whether it
    covers as much. `bounds`: beyond these, the silhouettes or wider ones, nothing is left; None: nothing is clipped.
    `depth` [h, w] metres, 0 = unknown, of the surface that is drawn says where cover is likely. `sharp`: trust in the
    outline and the light of what it gains, see `Outlines.sharpened`.
    """
    longer = max(alpha.shape)
    radius = max(REACH, round(HOLE * longer))
    if not (alpha > 0).any():  # a camera that looks past the subject
        return np.zeros(color.shape, np.float32), np.zeros(alpha.shape, np.float32)
    part = part_around(alpha > 0, max(radius, math.ceil(4 * _nearby(longer)), 2 * REACH) + 2)
    whole = np.zeros(color.shape, np.float32), np.zeros(alpha.shape, np.float32)
    c, a = color[part].astype(np.float32), alpha[part].astype(np.float32)
    drawn, corner = a > 0, (part[0].start, part[1].start)
    known, covered = np.zeros(a.shape, bool), np.ones(a.shape, np.float32)
    depth = None if depth is None else cv2.dilate(depth[part], np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8))
    if lit is not None:
        where = Fillable.of(a, longer)
        known = where.some & (a < 1)
        covered = cover(silhouettes, camera, known, corner=corner, depth=depth)
        c, a = filled(c, a, where, covered, longer, lit)
    if outlines is not None:
        c, a = outlines.evened(c, a)
    if bounds is not None:
        known &= bounds is silhouettes
        near = cv2.dilate(drawn.astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) > 0
        c, a = clipped(c, a, np.where(known, covered, cover(bounds, camera, near & (a > 0) & ~known, a, corner, depth)))
    if outlines is not None:
        c, a = outlines.sharpened(c, a, *sharp)
    for out, found in zip(whole, (c, a), strict=True):
        out[part] = found
    return whole
