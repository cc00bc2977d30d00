"""Readers over arrays, and a person walking before a textured wall with a soft shadow."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from uuid import uuid4

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, render, ring
from posegaussian.stages.simulator.subjects.motion import joints_at, pose


@dataclass
class Pictures:
    """[V] lists of pictures (or masks, or depth maps) numbered from 0;
    None where a view has none, which must not be read."""

    views: list[list[np.ndarray | None]]
    name: str = field(default_factory=lambda: uuid4().hex)

    def numbers(self, view: int) -> np.ndarray:
        return np.array([i for i, p in enumerate(self.views[view]) if p is not None])

    def size(self, view: int) -> tuple[int, int]:
        picture = next(p for p in self.views[view] if p is not None)
        return picture.shape[1], picture.shape[0]

    def identity(self, view: int, number: int) -> str:
        return f"{self.name} {view} {number}"

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        for n in numbers:
            picture = self.views[view][n]
            assert picture is not None, f"frame {n} of view {view} does not exist"
            yield picture.copy()

    def turned(self, view: int, numbers: Sequence[int]) -> list[int]:
        return []


def wall(size: int, seed: int) -> np.ndarray:
    """[size, size, 3] a mottled greyish wall, float."""
    rng = np.random.default_rng(seed)
    out = np.full((size, size, 3), 150.0)
    for cell, amplitude in ((size // 64, 11.0), (size // 16, 18.0), (size // 4, 24.0)):
        n = size // cell + 2
        grid = rng.normal(size=(n, n, 1)) + 0.25 * rng.normal(size=(n, n, 3))
        out += amplitude * cv2.resize(grid, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.clip(out, 30, 240)


def before(person: PersonCapture, view: int, backdrop: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8: the first frame of a person before a backdrop [h, w, 3], with a camera's noise."""
    color, mask = person.color[0, view].astype(float), person.mask[0, view, ..., None] / 255.0
    noise = np.random.default_rng(view).normal(0, 2, color.shape)
    return np.clip(np.rint(color * mask + backdrop * (1 - mask) + noise), 0, 255).astype(np.uint8)


@dataclass
class Joints:
    """[F, J, 3] joints of one person in every view, numbered from 0."""

    joints: np.ndarray
    joint_set: str = "coco17"

    def read(self, view: int, number: int) -> np.ndarray:
        return self.joints[None, number]


def film(
    size: int, view: int, offsets: np.ndarray, shadow: float = 0.35, seed: int = 3, noise: float = 3.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A kicking person, `offsets` [F] metres to the side in each frame, before a wall on which a soft shadow falls.

    Returns pictures [F, size, size, 3] and true masks [F, size, size] uint8, joints [F, 17, 3] px. The shadow takes
    `shadow` of the wall's sRGB value, beside and below the person, blurred.
    """
    rig, ground, rng = ring(8, size, 0), wall(size, seed), np.random.default_rng(seed + 1)
    n = len(offsets)
    pictures, truth, joints = (
        np.empty((n, size, size, 3), np.uint8),
        np.empty((n, size, size), np.uint8),
        np.ones((n, 17, 3)),
    )
    for f, offset in enumerate(offsets):
        bones = pose("kick", f / 30)
        bones[:, :3, 3] += offset * rig.rotations[view, 0]
        joints[f, :, :2] = project(joints_at(bones), rig.intrinsics[view], rig.world_to_camera[view])[0]
        color, mask, _ = render(bones, rig.intrinsics[view], rig.world_to_camera[view], (size, size), 2)
        cast = np.roll(mask, (size // 20, size // 12), axis=(0, 1)).astype(np.float32) / 255
        shade = 1.0 - shadow * cv2.GaussianBlur(cast, (0, 0), size / 60)[..., None]
        scene = color + (1.0 - mask[..., None] / 255.0) * ground * shade + rng.normal(0, noise, color.shape)
        pictures[f], truth[f] = np.clip(np.rint(scene), 0, 255).astype(np.uint8), mask
    return pictures, truth, joints


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two soft masks, cut at half."""
    a, b = a > 127, b > 127
    return float((a & b).sum() / max(1, (a | b).sum()))
