"""Cameras and bodies with known answers, for the tests of geometry and depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, rays, unproject
from posegaussian.storage.model.cameras import Rig


def camera(centre: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """[4, 4] world_to_camera at `centre` looking at `target`, world Z up, turned by `roll` degrees about its axis."""
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross(z, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    turn = np.radians(roll)
    upright = np.stack([x, np.cross(z, x), z])
    out = np.eye(4)
    out[:3, :3] = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]) @ upright
    out[:3, 3] = -out[:3, :3] @ centre
    return out


def on_ring(azimuth: float, elevation: float = 8.0, radius: float = 2.0) -> np.ndarray:
    """[3] a centre at degrees around and above the origin."""
    a, e = np.radians([azimuth, elevation])
    return radius * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def rig_of(poses: list[np.ndarray], size: tuple[int, int] = (1024, 1024), focal: float | list[float] = 819.2) -> Rig:
    """A rig with centred principal points."""
    n = len(poses)
    k = np.zeros((n, 3, 3))
    k[:, 0, 0] = k[:, 1, 1] = focal
    k[:, 0, 2], k[:, 1, 2], k[:, 2, 2] = size[0] / 2, size[1] / 2, 1
    return Rig(
        tuple(f"cam{i}" for i in range(n)), k, np.zeros((n, 8)), np.stack(poses), np.tile(np.array(size), (n, 1))
    )


def cut_aside(rig: Rig, degrees: float) -> Rig:
    """The same cameras turned to the side by so much, with pictures cut so far beside the principal point that what was
    in the middle of each is there still."""
    a = np.radians(degrees)
    turn, k = np.eye(4), rig.intrinsics.copy()
    turn[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    middle = np.concatenate([rig.size / 2, np.ones((len(rig), 1))], axis=1)
    seen = np.linalg.solve(k, middle[..., None])[..., 0] @ turn[:3, :3].T
    k[:, :2, 2] = middle[:, :2] - np.einsum("vij,vj->vi", k[:, :2, :2], seen[:, :2] / seen[:, 2:])
    return replace(rig, intrinsics=k, world_to_camera=turn @ rig.world_to_camera)


def ring(views: int, size: tuple[int, int] = (64, 64), focal: float = 60.0, radius: float = 2.0) -> Rig:
    """Cameras evenly around the origin."""
    return rig_of([camera(on_ring(360 * i / views, radius=radius), np.zeros(3)) for i in range(views)], size, focal)


def sphere_depth(rig: Rig, view: int, centre: np.ndarray, radius: float) -> np.ndarray:
    """[h, w] exact depth of a sphere along the optical axis at the pixel centres, 0 beside it."""
    origin, directions = rays(pixel_centres(tuple(rig.size[view])), rig.intrinsics[view], rig.world_to_camera[view])
    to = origin - centre
    a = (directions**2).sum(-1)
    b = directions @ to
    inside = b**2 - a * (to @ to - radius**2)
    return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, 0.0)


def sphere_mask(rig: Rig, view: int, centre: np.ndarray, radius: float, samples: int = 4) -> np.ndarray:
    """[h, w] uint8 covered share of each pixel, 0..255."""
    w, h = rig.size[view]
    fine = rig_of([rig.world_to_camera[view]], (w * samples, h * samples), rig.intrinsics[view, 0, 0] * samples)
    covered = sphere_depth(fine, 0, centre, radius) > 0
    return np.rint(255 * covered.reshape(h, samples, w, samples).mean(axis=(1, 3))).astype(np.uint8)


def textured_sphere(rig: Rig, view: int, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture [h, w, 3] uint8 and true depth of a sphere whose colour is a smooth function of the point."""
    depth = sphere_depth(rig, view, centre, radius)
    p = unproject(depth, rig.intrinsics[view], rig.world_to_camera[view])
    waves = [
        np.sin(p @ np.array(k)) * np.cos(p @ np.array(m))
        for k, m in (((31, 17, 23), (5, 29, -11)), ((13, -37, 7), (19, 3, 31)), ((-23, 11, 29), (37, 7, 13)))
    ]
    color = np.where((depth > 0)[..., None], 127.5 + 120 * np.stack(waves, axis=-1), 0)
    return np.rint(color).astype(np.uint8), depth.astype(np.float32)
