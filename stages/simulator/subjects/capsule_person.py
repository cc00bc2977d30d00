"""The capsule person: a capture with exact truth, made from nothing but formulas.

An analytic body of ellipsoids and round cones with a fixed fine texture is ray-cast into a ring of cameras. Colour is a
function of the point of the body at rest and of its world normal, so it moves with the limbs and does not depend on the
camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.render.raycast import cast
from posegaussian.stages.simulator.render.texture import shade
from posegaussian.stages.simulator.subjects.motion import GEOMETRY, KINDS, MATERIALS, PART_BONES, joints_at, pose
from posegaussian.storage.model.cameras import Rig, rigid

FRAME_RATE = 30.0
RADIUS = 2.4
CAMERA_HEIGHT = 1.15
TARGET = np.array([0.0, 0.0, 0.93])
FOCAL = 1.05
"""Focal length over picture width: 2.3 m across at the person, who keeps a margin in every motion."""


@dataclass(frozen=True, eq=False)
class PersonCapture:
    """F frames of V square pictures with their truth."""

    rig: Rig
    """V cameras without distortion: the source ring first ("cam00", ...), then held-out ones ("mid00", ...)."""
    views: Views
    """Roles of the cameras."""
    color: np.ndarray
    """[F, V, h, w, 3] uint8 sRGB, premultiplied on black."""
    mask: np.ndarray
    """[F, V, h, w] uint8 covered share of the pixel, 0..255."""
    depth: np.ndarray
    """[F, V, h, w] float32 metres along the optical axis at the pixel centre; 0 = none."""
    joints2d: np.ndarray
    """[F, V, 17, 3] float64 (u, v, score), our pixel centres; exact projections, whether hidden or not; score 1."""
    joints3d: np.ndarray
    """[F, 17, 4] float64 (x, y, z, 1), world metres; Z is up and the feet stand at z = 0."""
    frame_rate: float
    """Frames per second."""


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """[4, 4] world_to_camera of a camera at `centre` [3] that looks at `target` [3] with the world's Z up."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rigid(rotation, -rotation @ centre)


def ring(views: int, size: int, held_out: int) -> Rig:
    """Rig of `views` cameras evenly around the person, cam00 in front, and `held_out` ones in gaps spread over the
    ring.

    Raises ValueError when there are no views or more held-out cameras than gaps.
    """
    if views < 1 or not 0 <= held_out <= views:
        raise ValueError(
            f"{views} views and {held_out} held-out cameras: at least one view, and at most one held-out camera a gap"
        )
    turns = [*range(views), *(k * views // held_out + 0.5 for k in range(held_out))]
    angles = 2.0 * math.pi * np.array(turns) / views
    centres = np.stack([RADIUS * np.cos(angles), RADIUS * np.sin(angles), np.full(len(angles), CAMERA_HEIGHT)], axis=1)
    k = np.array([[FOCAL * size, 0.0, size / 2], [0.0, FOCAL * size, size / 2], [0.0, 0.0, 1.0]])
    names = (*(f"cam{i:02d}" for i in range(views)), *(f"mid{i:02d}" for i in range(held_out)))
    n = len(names)
    poses = np.stack([look_at(c, TARGET) for c in centres])
    return Rig(names, np.repeat(k[None], n, axis=0), np.zeros((n, 8)), poses, np.full((n, 2), size, dtype=np.int64))


def samples_per_side(size: int) -> int:
    """Samples a side of a pixel: 2 at 512 px, more below, so that the finest texture never aliases."""
    return max(2, min(8, math.ceil(640 / size)))


def render(
    bones: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray, size: tuple[int, int], samples: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One picture of a posed person: color [h, w, 3] uint8, mask [h, w] uint8, depth [h, w] float32 at pixel centres.

    bones [B, 4, 4] rest to world; intrinsics [3, 3] px in our pixel centres, no distortion; world_to_camera [4, 4];
    size (width, height) px; `samples` a side of each pixel for colour and mask.
    """
    to_camera = world_to_camera @ bones[PART_BONES]
    rotation, shift = np.ascontiguousarray(to_camera[:, :3, :3]), np.ascontiguousarray(to_camera[:, :3, 3])
    k, size = np.ascontiguousarray(intrinsics, dtype=np.float64), (int(size[0]), int(size[1]))
    depth, hit = cast(KINDS, GEOMETRY, rotation, shift, k, size, 1)
    fine = (depth, hit) if samples == 1 else cast(KINDS, GEOMETRY, rotation, shift, k, size, samples)
    to_world = np.ascontiguousarray(bones[PART_BONES, :3, :3])
    color, cover = shade(*fine, KINDS, GEOMETRY, MATERIALS, to_world, rotation, shift, k, samples)
    depth[hit < 0] = 0.0
    return np.rint(255.0 * color).astype(np.uint8), np.rint(255.0 * cover).astype(np.uint8), depth.astype(np.float32)


def capture_person(
    views: int = 8, size: int = 48, frames: int = 6, held_out: int = 2, motion: str = "wave"
) -> PersonCapture:
    """Film the person with a ring of cameras at 2.4 m and held-out ones in the middle between neighbours.

    size: side of the square pictures, px; motion: stand, wave or kick. Raises ValueError for an unknown motion and for
    more held-out cameras than gaps.
    """
    rig = ring(views, size, held_out)
    n = len(rig)
    color = np.empty((frames, n, size, size, 3), dtype=np.uint8)
    mask, depth = np.empty(color.shape[:-1], dtype=np.uint8), np.empty(color.shape[:-1], dtype=np.float32)
    joints2d, joints3d = np.ones((frames, n, 17, 3)), np.ones((frames, 17, 4))
    for f in range(frames):
        bones = pose(motion, f / FRAME_RATE)
        joints3d[f, :, :3] = joints_at(bones)
        for v in range(n):
            joints2d[f, v, :, :2] = project(joints3d[f, :, :3], rig.intrinsics[v], rig.world_to_camera[v])[0]
            color[f, v], mask[f, v], depth[f, v] = render(
                bones, rig.intrinsics[v], rig.world_to_camera[v], (size, size), samples_per_side(size)
            )
    roles = Views(rig.names, tuple(range(views)), tuple(range(views, n)))
    return PersonCapture(rig, roles, color, mask, depth, joints2d, joints3d, FRAME_RATE)
