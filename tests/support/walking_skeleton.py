"""A ring of cameras around a point skeleton, and readers over arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posegaussian.stages.contract.io import Views
from posegaussian.storage.model.cameras import Rig, rigid

SKELETON = np.array(
    [
        *[(0.12, 0.0, 1.60), (0.10, 0.03, 1.64), (0.10, -0.03, 1.64), (0.02, 0.08, 1.62), (0.02, -0.08, 1.62)],
        *[
            (0.0, 0.19, 1.42),
            (0.0, -0.19, 1.42),
            (0.02, 0.32, 1.16),
            (0.02, -0.32, 1.16),
            (0.12, 0.36, 0.93),
            (0.12, -0.36, 0.93),
        ],
        *[
            (0.0, 0.10, 0.92),
            (0.0, -0.10, 0.92),
            (0.04, 0.12, 0.49),
            (0.04, -0.12, 0.49),
            (0.0, 0.13, 0.08),
            (0.0, -0.13, 0.08),
        ],
    ]
)
"""[17, 3] COCO-17 of a standing person, metres, Z up."""


def ring(views: int, size: int = 256, radius: float = 2.6, focal: float = 1.0, degrees: float = 360.0) -> Rig:
    """Cameras at 1.2 m height around the Z axis that look at (0, 0, 0.9)."""
    poses = []
    for v in range(views):
        a = np.deg2rad(degrees) * v / views
        centre = np.array([radius * np.cos(a), radius * np.sin(a), 1.2])
        forward = np.array([0, 0, 0.9]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        poses.append(rigid(rotation, -rotation @ centre))
    k = np.array([[focal * size, 0, size / 2 + 3], [0, focal * size * 1.02, size / 2 - 2], [0, 0, 1.0]])
    return Rig(
        tuple(f"cam{v:02d}" for v in range(views)),
        np.tile(k, (views, 1, 1)),
        np.zeros((views, 8)),
        np.stack(poses),
        np.full((views, 2), size),
    )


def pixels(rig: Rig, points: np.ndarray) -> np.ndarray:
    """Exact (u, v, 1) [F, V, J, 3] of points [F, J, 3], written out independently of the stage."""
    out = np.ones((len(points), len(rig), points.shape[1], 3))
    for v in range(len(rig)):
        camera = points @ rig.rotations[v].T + rig.world_to_camera[v, :3, 3]
        homogeneous = camera @ rig.intrinsics[v].T
        out[:, v, :, :2] = homogeneous[..., :2] / homogeneous[..., 2:]
    return out


def walk(frames: int) -> np.ndarray:
    """[F, 17, 3] the skeleton shifted a little every frame."""
    return SKELETON + np.array([0.03, -0.02, 0.0]) * np.arange(frames)[:, None, None]


@dataclass
class Joints2D:
    """Reader over people[frame][view], a list of [J, 3]; fails for what must not be read."""

    people: list[list[list[np.ndarray]]]
    forbidden: set[tuple[int, int]] = field(default_factory=set)
    joint_set: str = "coco17"

    @classmethod
    def single(cls, joints: np.ndarray, **more: object) -> Joints2D:
        return cls([[[joints[f, v]] for v in range(joints.shape[1])] for f in range(len(joints))], **more)  # type: ignore[arg-type]

    def read(self, view: int, number: int) -> np.ndarray:
        assert (number, view) not in self.forbidden, f"frame {number} of view {view} was read"
        people = self.people[number][view]
        return np.array(people, dtype=np.float64).reshape(len(people), -1, 3) if people else np.zeros((0, 17, 3))


@dataclass
class Joints3D:
    joints: np.ndarray
    joint_set: str = "coco17"

    def read(self, number: int) -> np.ndarray:
        return self.joints[number]


def roles(rig: Rig, held_out: tuple[int, ...] = ()) -> Views:
    return Views(rig.names, tuple(v for v in range(len(rig)) if v not in held_out), held_out)


def moving(frames: int) -> np.ndarray:
    """[F, 17, 3] metres: somebody who turns, waves and goes."""
    t = np.arange(frames)
    out = np.repeat(SKELETON[None], frames, axis=0)
    out[:, 9] += np.column_stack([0.1 * np.sin(0.5 * t), 0 * t, 0.2 * np.cos(0.5 * t)])
    c, s = np.cos(0.1 * t), np.sin(0.1 * t)
    turn = np.stack([np.stack([c, -s, 0 * c]), np.stack([s, c, 0 * c]), np.stack([0 * c, 0 * c, 1 + 0 * c])]).transpose(
        2, 0, 1
    )
    return np.einsum("fab,fjb->fja", turn, out) + 0.02 * t[:, None, None]


def scored(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
