"""How bright cameras see the same patches of the body: their exposures' disagreement, and the gains that even them out.

Shading differs around a body as much as exposures do between cameras, so what is compared must be the same surface. A patch
is a place on the skin or cloth beside a joint: the joint's 3D position, moved by the limb's usual radius in one of 16
horizontal directions, outwards from the body. Every camera within 60 degrees of that direction sees the same patch, whatever
lights it. Measured is the light that matte surfaces send to both cameras; gloss, wrong limb radii and what hangs before a
patch are errors, and count as such: a difference is believed as far as it exceeds two standard errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stages.frames.display import to_linear
from stages.frames.layout import captured_positions
from stages.geometry.projection import project
from stages.geometry.subject import up_direction
from stages.survey.params import NONE
from storage.joints import joint_set
from storage.rig import Rig, points_from_integer_centres

RADII = {"Shoulder": 0.055, "Elbow": 0.045, "Wrist": 0.03, "Hip": 0.1, "Knee": 0.055, "Ankle": 0.04}
"""Metres from a joint to the surface of a grown person, roughly; a face is left out, it has no plain colour."""
DIRECTIONS = 16
FACING = 0.5
"""Least cosine between a patch's direction and the camera's: 60 degrees, so that cameras 90 degrees apart share patches."""
SMALLEST = 3.0
"""px: a limb with a smaller radius in the picture shows its background as well."""
SPOT = 0.25
"""Radius of the disc that is looked at, over the limb's."""
DARKEST, BRIGHTEST = 8, 247
"""sRGB values beyond which a colour is noise or clipped and says nothing about exposure."""
FEWEST = 4
"""Joints beside which two cameras must share patches before they are compared."""
FEWEST_POINTS = 16
"""Surface points that two cameras must share before these are asked instead of patches of the body."""
ERRORS = 2.0
"""Standard errors by which a difference must exceed zero, and is lessened before it is compared with a bound."""
TRUNK = [5, 6, 11, 12]
"""Shoulders and hips in COCO-17: the middle of the body."""
NAMES = joint_set("coco17").names
JOINTS = np.array([i for i, n in enumerate(NAMES) if n[1:] in RADII])
"""[12] indices in COCO-17."""
PATCHES = len(JOINTS) * DIRECTIONS


def patch_points(joints: np.ndarray, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres [192, 3] in the world, directions [192, 3] and radii [192] of all patches.

    The radius is 0 where the joint is unknown, and where the direction points to the body's middle: another limb is there.
    joints [17, 4] COCO-17 (x, y, z, score), world metres.
    """
    up = up_direction(rig)
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    turn = np.arange(DIRECTIONS)[:, None] * (2 * np.pi / DIRECTIONS)
    ring = np.cos(turn) * side + np.sin(turn) * np.cross(up, side)
    trunk = joints[TRUNK][joints[TRUNK, 3] > 0, :3]
    beside = joints[JOINTS, :3] - (trunk.mean(axis=0) if len(trunk) else 0.0)
    outwards = (beside @ ring.T >= 0) & (len(trunk) > 0)
    radius = np.array([RADII[NAMES[j][1:]] for j in JOINTS]) * (joints[JOINTS, 3] > 0)
    centres = joints[JOINTS, None, :3] + radius[:, None, None] * ring
    return centres.reshape(-1, 3), np.tile(ring, (len(JOINTS), 1)), (radius[:, None] * outwards).ravel()


def patch_colors(picture: np.ndarray, joints: np.ndarray, rig: Rig, source_rig: Rig, crops: np.ndarray, view: int) -> np.ndarray:
    """Median colour [192, 3] sRGB float of every patch in one captured picture [h, w, 3] uint8; 0 where it is not seen.

    joints [17, 4] as in `patch_points`; rig, source_rig and crops [V, 3] as `captured_positions` wants them. That something
    else of the body stands before a patch is not checked: medians over joints and frames must bear it.
    """
    points, directions, radii = patch_points(joints, rig)
    ray = rig.centres[view] - points
    facing = (ray * directions).sum(axis=1) > FACING * np.linalg.norm(ray, axis=1)
    pixels, depth = project(points, rig.intrinsics[view], rig.world_to_camera[view])
    ahead = facing & (radii > 0) & (depth > 0)
    out = np.zeros((PATCHES, 3))
    if not ahead.any():
        return out
    spots = captured_positions(pixels[ahead], rig.intrinsics[view], source_rig.intrinsics[view], source_rig.distortion[view], crops[view])
    limbs = radii[ahead] / depth[ahead] * source_rig.intrinsics[view, 0, 0] / crops[view, 0]
    for patch, spot, limb in zip(np.flatnonzero(ahead), spots, limbs, strict=True):
        if limb >= SMALLEST and np.isfinite(spot).all():
            out[patch] = _disc(picture, spot, max(0.75, SPOT * limb))
    return out


def _disc(picture: np.ndarray, spot: np.ndarray, radius: float) -> np.ndarray:
    """Median colour [3] of the pixels whose centres lie in a disc; 0 where the disc holds none."""
    (u, v), (height, width) = spot, picture.shape[:2]
    columns, rows = (np.arange(max(0, int(np.floor(c - radius))), min(n, int(np.ceil(c + radius)))) for c, n in ((u, width), (v, height)))
    if not (len(columns) and len(rows)):
        return np.zeros(3)
    inside = (points_from_integer_centres(columns)[None, :] - u) ** 2 + (points_from_integer_centres(rows)[:, None] - v) ** 2 <= radius**2
    pixels = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1][inside]
    return np.median(pixels, axis=0) if len(pixels) else np.zeros(3)


def typical_colors(samples: np.ndarray) -> np.ndarray:
    """Median over frames of patch colours [n, 192, 3] sRGB -> [192, 3] float32 linear light, 0..1; 0 where unknown.

    A patch counts where at least three frames (all, of fewer) show it, and where no channel is clipped or nearly black.
    """
    known: np.ndarray = np.any(samples > 0, axis=2)
    out = np.zeros(samples.shape[1:])
    for p in np.flatnonzero(known.sum(axis=0) >= min(3, max(1, len(samples)))):
        color = np.median(samples[known[:, p], p], axis=0)
        if (color >= DARKEST).all() and (color <= BRIGHTEST).all():
            out[p] = to_linear(color)
    return out.astype(np.float32)


class Matching(NamedTuple):
    """What brings S cameras to the same exposure and white balance."""

    gains: np.ndarray
    """[S, 3] factors on linear light; 1 for a camera whose difference may be an error of the measure."""
    stops: np.ndarray
    """[S] largest correction of a channel."""
    proven: np.ndarray
    """[S] largest difference of a channel less two standard errors, at least 0, in stops."""


def match(colors: np.ndarray, surface: np.ndarray | None = None) -> Matching | None:
    """Compare S cameras by surface points [S, S, 64, 3] (`surface.surface_stops`), and by their patches [S, 192, 3], linear light, 0 where not seen.

    Two cameras that share at least `FEWEST_POINTS` surface points differ by their median; else two that share patches beside
    at least `FEWEST` joints by the median over joints of the median over a joint's patches, in stops. Least squares over all
    such pairs gives each camera's offset; the spread of the points and joints about it gives the standard error. Cameras that
    pairs link are a group and are brought to its median camera, so that one odd camera follows the others; nothing is known
    between groups, which look at different sides, or of a camera without a pair. None without any pair.
    """
    count = len(colors)
    differ = {}
    for a in range(count):
        for b in range(a + 1, count):
            points = _points(surface[a, b]) if surface is not None else np.zeros((0, 3))
            d = points if len(points) >= FEWEST_POINTS else _by_joint(colors[a], colors[b])
            if len(d) >= FEWEST:
                differ[a, b] = d
    if not differ:
        return None
    laplacian, right = np.zeros((count, count)), np.zeros((count, 3))
    for (a, b), d in differ.items():
        laplacian[[a, b], [a, b]] += len(d)
        laplacian[[a, b], [b, a]] -= len(d)
        right[a] += len(d) * np.median(d, axis=0)
        right[b] -= len(d) * np.median(d, axis=0)
    inverse = np.linalg.pinv(laplacian)
    off = inverse @ right
    residual = np.concatenate([d - (off[a] - off[b]) for (a, b), d in differ.items()])
    # 1.4826 MAD is a normal's standard deviation; a median's variance is pi / 2 times a mean's.
    error = np.sqrt(np.diag(inverse) * np.pi / 2)[:, None] * 1.4826 * np.median(np.abs(residual), axis=0)
    linked = np.linalg.matrix_power((laplacian != 0) | np.eye(count, dtype=bool), count)
    stops = np.stack([np.median(off[linked[a]], axis=0) for a in range(count)]) - off
    proven = np.maximum(np.abs(stops) - ERRORS * error, 0.0).max(axis=1)
    stops = np.where((proven > 0)[:, None], stops, 0.0)
    return Matching(np.exp2(stops), np.abs(stops).max(axis=1), proven)


def _points(stops: np.ndarray) -> np.ndarray:
    """[n, 3] of the surface points [64, 3] those that there are."""
    return stops[(stops < NONE).all(axis=-1)].astype(np.float64)


def _by_joint(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[n, 3] stops between the colours [192, 3] of two cameras beside each of the n joints where they share a patch."""
    both: np.ndarray = np.all((first > 0) & (second > 0), axis=1).reshape(-1, DIRECTIONS)
    a, b = (np.where(both[..., None], c.reshape(-1, DIRECTIONS, 3).astype(np.float64), 1.0) for c in (first, second))
    stops = np.log2(a) - np.log2(b)
    return np.array([np.median(stops[j, both[j]], axis=0) for j in np.flatnonzero(both.any(axis=1))]).reshape(-1, 3)
