"""Places beside joints that several cameras see alike, and their colours.

Shading differs around a body, so what is compared between cameras must be the same surface. A patch is a place on the
skin or cloth beside a joint: the joint's 3D position, moved by the limb's usual radius in one of 16 horizontal
directions, outwards from the body. Every camera within 60 degrees of that direction sees the same patch. Wrong limb
radii, folds, gloss and what hangs before a patch are errors: patches tell whether views disagree, and never by how much
a camera is brighter.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.subject import up_direction
from posegaussian.stages.imaging.camera_mapping import captured_positions
from posegaussian.stages.imaging.color import to_linear
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres
from posegaussian.storage.model.joint_sets import joint_set

RADII = {"Shoulder": 0.055, "Elbow": 0.045, "Wrist": 0.03, "Hip": 0.1, "Knee": 0.055, "Ankle": 0.04}
"""Metres from a joint to the surface of a grown person, roughly; a face is left out, it has no plain colour."""
DIRECTIONS = 16
FACING = 0.5
"""Least cosine between a patch's direction and the camera's: 60 degrees, so that cameras 90 degrees apart share
patches."""
SMALLEST = 3.0
"""px: a limb with a smaller radius in the picture shows its background as well."""
SPOT = 0.25
"""Radius of the disc that is looked at, over the limb's."""
DARKEST, BRIGHTEST = 8, 247
"""sRGB values beyond which a colour is noise or clipped and says nothing about exposure."""
TRUNK = [5, 6, 11, 12]
"""Shoulders and hips in COCO-17: the middle of the body."""
NAMES = joint_set("coco17").names
JOINTS = np.array([i for i, n in enumerate(NAMES) if n[1:] in RADII])
"""[12] indices in COCO-17."""
PATCHES = len(JOINTS) * DIRECTIONS


def patch_points(joints: np.ndarray, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres [192, 3] in the world, directions [192, 3] and radii [192] of all patches.

    The radius is 0 where the joint is unknown, and where the direction points to the body's middle: another limb is
    there. joints [17, 4] COCO-17 (x, y, z, score), world metres.
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


def patch_colors(
    picture: np.ndarray, joints: np.ndarray, rig: Rig, source_rig: Rig, crops: np.ndarray, view: int
) -> np.ndarray:
    """Median colour [192, 3] sRGB float of every patch in one captured picture [h, w, 3] uint8; 0 where it is not seen.

    joints [17, 4] as in `patch_points`; rig, source_rig and crops [V, 3] as `captured_positions` wants them. That
    something else of the body stands before a patch is not checked: medians over joints and frames must bear it.
    """
    points, directions, radii = patch_points(joints, rig)
    ray = rig.centres[view] - points
    facing = (ray * directions).sum(axis=1) > FACING * np.linalg.norm(ray, axis=1)
    pixels, depth = project(points, rig.intrinsics[view], rig.world_to_camera[view])
    ahead = facing & (radii > 0) & (depth > 0)
    out = np.zeros((PATCHES, 3))
    if not ahead.any():
        return out
    spots = captured_positions(
        pixels[ahead], rig.intrinsics[view], source_rig.intrinsics[view], source_rig.distortion[view], crops[view]
    )
    limbs = radii[ahead] / depth[ahead] * source_rig.intrinsics[view, 0, 0] / crops[view, 0]
    for patch, spot, limb in zip(np.flatnonzero(ahead), spots, limbs, strict=True):
        if limb >= SMALLEST and np.isfinite(spot).all():
            out[patch] = _disc(picture, spot, max(0.75, SPOT * limb))
    return out


def _disc(picture: np.ndarray, spot: np.ndarray, radius: float) -> np.ndarray:
    """Median colour [3] of the pixels whose centres lie in a disc; 0 where the disc holds none."""
    (u, v), (height, width) = spot, picture.shape[:2]
    columns, rows = (
        np.arange(max(0, int(np.floor(c - radius))), min(n, int(np.ceil(c + radius))))
        for c, n in ((u, width), (v, height))
    )
    if not (len(columns) and len(rows)):
        return np.zeros(3)
    inside = (points_from_integer_centres(columns)[None, :] - u) ** 2 + (
        points_from_integer_centres(rows)[:, None] - v
    ) ** 2 <= radius**2
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
