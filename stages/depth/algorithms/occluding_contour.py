"""Where a surface turns away at the silhouette: its last pixels continue the measured ones on a round cross-section.

At an occluding contour a smooth surface is tangent to the ray: s px inside it, the depth is a - k sqrt(2 R s - s^2), R
half the thickness of the limb in px and k one pixel footprint where its cross-section is round. Matching windows cannot
follow that: the outermost pixels come out too flat, face the wrong way and show up beside the subject or in front of it
in every other view. Within a few px of the silhouette the depth is therefore taken from the law, fitted to what was
measured further in.
"""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.matching.fuse import HULL
from posegaussian.storage.model.cameras import Rig

CORE = (1.0, 2.0, 1 / 256)
"""Px from the silhouette within which depth is continued instead of measured: at least, at most, and over the
picture's longer side. In a small picture an arm is a few px wide, and its last px still measured better than
guessed."""
REACH = 4.0
"""Px beyond the core that are fitted."""
ROUND = 0.2
"""Weight of a round cross-section against the measured one, per px of R: the variance of the height over the fitted
pixels, over R, is as large."""
WIDEST = 0.08
"""Half thickness, over the picture's longer side, above which a body is no rounder than this."""
STEEP = 12.0
"""Pixel footprints of depth by which fitted pixels may differ: beyond is another surface."""


def turn_away(
    rig: Rig,
    view: int,
    depth: np.ndarray,
    confidence: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    inside: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [h, w] of a view with its rim continued from further in, within the hull; what has no depth
    keeps none.

    `depth` is metres along the optical axis, `near` and `far` the hull's, `inside` [h, w] bool the silhouette. What the
    picture's edge cuts off is no contour and stays as it is, as do a picture that shows nothing else, one of a single
    row or column, and a rim without measured depth further in: the hull turns away by itself.
    """
    width, height = (int(n) for n in rig.size[view])
    if min(width, height) < 2 or inside[:height, :width].all():
        return depth.astype(np.float32), confidence
    distance = cv2.distanceTransform(inside[:height, :width].astype(np.uint8), cv2.DIST_L2, 5)
    down, right = np.gradient(cv2.GaussianBlur(distance, (0, 0), 1.5))
    length = np.hypot(down, right) + 1e-6
    focal = float(rig.intrinsics[view, [0, 1], [0, 1]].mean())
    turned = depth.copy()
    turned[:height, :width] = _continued(
        depth[:height, :width],
        confidence[:height, :width] > HULL + 0.01,
        distance,
        (down / length).astype(np.float32),
        (right / length).astype(np.float32),
        1 / focal,
        WIDEST * max(width, height),
        float(np.clip(CORE[2] * max(width, height), *CORE[:2])),
    )
    return np.where(turned != depth, np.clip(turned, near, far), depth).astype(np.float32), confidence


@compiled
def _continued(
    depth: np.ndarray,
    measured: np.ndarray,
    distance: np.ndarray,
    down: np.ndarray,
    right: np.ndarray,
    pixel: float,
    widest: float,
    core: float,
) -> np.ndarray:
    height, width = depth.shape
    out = depth.copy()
    for i in range(height):
        for j in range(width):
            if depth[i, j] <= 0 or distance[i, j] <= 0 or distance[i, j] > core:
                continue
            thickness, first = _thickness(distance, down, right, i, j, widest), 0.0
            count, roots, squares, depths, products = 0, 0.0, 0.0, 0.0, 0.0
            y, x = float(i), float(j)
            for _ in range(int(core + REACH + 1)):
                row, column = int(np.rint(y)), int(np.rint(x))
                if row < 0 or column < 0 or row >= height or column >= width:
                    break
                s, z = distance[row, column], depth[row, column]
                if core < s <= min(core + REACH, thickness + 0.5) and z > 0 and measured[row, column]:
                    first = z if first == 0 else first
                    if abs(z - first) < STEEP * pixel * first:
                        root = _height(s, thickness)
                        count, roots, squares, depths, products = (
                            count + 1,
                            roots + root,
                            squares + root * root,
                            depths + z,
                            products + root * z,
                        )
                y, x = y + down[row, column], x + right[row, column]
            if count == 0:
                continue
            roots, depths, prior = roots / count, depths / count, ROUND * thickness
            slope = (roots * depths - products / count + prior * pixel * first) / (
                squares / count - roots * roots + prior
            )
            slope = min(max(slope, 0.3 * pixel * first), 2 * pixel * first)
            out[i, j] = depths - slope * (_height(distance[i, j], thickness) - roots)
    return out


@compiled
def _thickness(distance: np.ndarray, down: np.ndarray, right: np.ndarray, i: int, j: int, widest: float) -> float:
    """Half the thickness of the silhouette at a pixel of its rim, px: the largest distance on the way inwards."""
    thickness = 0.0
    y, x = float(i), float(j)
    for _ in range(int(widest)):
        row, column = int(np.rint(y)), int(np.rint(x))
        if (
            row < 0
            or column < 0
            or row >= distance.shape[0]
            or column >= distance.shape[1]
            or distance[row, column] < thickness - 1
        ):
            break
        thickness = max(thickness, distance[row, column])
        y, x = y + down[row, column], x + right[row, column]
    return min(thickness, widest)


@compiled
def _height(distance: float, radius: float) -> float:
    """Height above the contour, px, of a round surface at a distance from the nearest background pixel's centre:
    half a px of it is not inside."""
    s = min(max(distance - 0.5, 0.05), radius)
    return np.sqrt(2 * radius * s - s * s)
