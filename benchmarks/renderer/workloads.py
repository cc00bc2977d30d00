"""Scenes for the renderer's benchmark: a person lifted from two source views, random blobs, a captured guitar."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch

from posegaussian.stages.gaussians.prior import normals, scales
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.simulator.subjects.capsule_person import look_at, render
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.stages.splatting.quaternions import rotations

SOURCE = 512
"""Side of the person's source pictures, px."""
ZOOM = 1.9
"""Focal length over picture width: the body fills 27 % of a source picture."""
DISTANCE = 2.4
"""From the cameras to the body's axis, m."""
FOOTPRINT = 1.03
"""Standard deviation in source pixels:
5.1 million pairs of a Gaussian and a pixel pass the alpha test in a 512 px picture."""
GUITAR = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "splats" / "guitar.compressed.ply"


def _camera(degrees: float, size: int) -> Camera:
    a = np.radians(degrees)
    centre = np.array([DISTANCE * np.cos(a), DISTANCE * np.sin(a), 1.2])
    k = np.array([[ZOOM * size, 0.0, size / 2], [0.0, ZOOM * size, size / 2], [0.0, 0.0, 1.0]])
    return Camera(k, look_at(centre, np.array([0.0, 0.0, 1.15])), size, size)


def person(size: int) -> tuple[Gaussians, Camera]:
    """About 145,000 pixel-aligned Gaussians of two source views 45 degrees apart, of the prior's opacities, seen
    from the middle."""
    target, parts = _camera(0.0, size), []
    for degrees in (-22.5, 22.5):
        source = _camera(degrees, SOURCE)
        color, mask, depth = render(
            pose("wave", 0.2), np.asarray(source.intrinsics), np.asarray(source.world_to_camera), (SOURCE, SOURCE), 2
        )
        normal = normals(depth, np.asarray(source.intrinsics))
        scale = scales(depth, normal, np.asarray(source.intrinsics), FOOTPRINT, 0.1, 0.5)
        face_on = np.where(depth > 0, 0.99 * mask / np.float32(255), 0)
        maps = GaussianMaps(color, depth, scale, normal, np.stack([face_on, 0.8 * face_on]))
        parts.append(
            lift(
                maps,
                np.asarray(source.intrinsics),
                np.asarray(source.world_to_camera),
                torch.float32,
                torch.device("cpu"),
            ).seen_from(target)
        )
    return Gaussians.concatenate(parts), target


def blobs(size: int, count: int = 100_000) -> tuple[Gaussians, Camera]:
    """Random Gaussians 1-30 px wide (6 sigma) in every direction, all over the picture, of every opacity."""
    rng = np.random.default_rng(0)
    focal = 1.2 * size
    z = rng.uniform(1.0, 5.0, count)
    mean = np.stack([*(rng.uniform(-0.45, 0.45, (2, count)) * z), z], axis=1)
    scale = rng.uniform(1 / 6, 30 / 6, (count, 3)) * z[:, None] / focal
    parts = (
        mean,
        np.linalg.qr(rng.normal(size=(count, 3, 3)))[0],
        scale,
        rng.uniform(0.05, 1.0, count),
        rng.uniform(0, 1, (count, 3)),
    )
    k = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Gaussians(*(torch.as_tensor(p, dtype=torch.float32) for p in parts)), Camera(k, np.eye(4), size, size)


def guitar(size: int) -> tuple[Gaussians, Camera]:
    """A guitar of 90,854 Gaussians from photographs, filling the picture.
    Raises FileNotFoundError where the file is not."""
    mean, quaternion, scale, opacity, color = read_compressed(GUITAR)
    low, high = np.percentile(mean, [2, 98], axis=0)
    centre, extent = (low + high) / 2, float((high - low).max())
    distance = 1.5 * extent
    world_to_camera = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ (centre + np.array([distance, 0, 0]))
    k = np.array([[1.5 * size, 0, size / 2], [0, 1.5 * size, size / 2], [0, 0, 1.0]])
    turn = rotations(torch.from_numpy(quaternion)).float()
    m, s, o, c = (torch.as_tensor(p, dtype=torch.float32) for p in (mean, scale, opacity, color))
    return Gaussians(m, turn, s, o, c), Camera(k, world_to_camera, size, size)


def read_compressed(path: Path) -> tuple[np.ndarray, ...]:
    """(mean [N, 3], quaternion [N, 4] wxyz, scale [N, 3], opacity [N], color [N, 3])
    of a PLY of packed chunks of 256."""
    raw = path.read_bytes()
    end = raw.index(b"end_header\n") + len(b"end_header\n")
    counts = [int(line.split()[2]) for line in raw[:end].decode().splitlines() if line.startswith("element")]
    chunks = np.frombuffer(raw, "<f4", counts[0] * 18, end).reshape(counts[0], 18)
    packed = np.frombuffer(raw, "<u4", counts[1] * 4, end + chunks.nbytes).reshape(counts[1], 4)
    chunk = chunks[np.arange(counts[1]) // 256].astype(np.float64)

    def spread(bits: np.ndarray, at: int) -> np.ndarray:
        share = np.stack([(bits >> 21) / 2047, (bits >> 11 & 1023) / 1023, (bits & 2047) / 2047], axis=1)
        return chunk[:, at : at + 3] + share * (chunk[:, at + 3 : at + 6] - chunk[:, at : at + 3])

    bits = packed[:, 1]
    three = (np.stack([bits >> 20 & 1023, bits >> 10 & 1023, bits & 1023], axis=1) / 1023 - 0.5) * np.sqrt(2)
    fourth = np.sqrt(np.maximum(0, 1 - (three**2).sum(axis=1)))
    quaternion = np.empty((counts[1], 4))
    for largest in range(4):
        rows = bits >> 30 == largest
        quaternion[rows] = np.insert(three[rows], largest, fourth[rows], axis=1)
    color = np.stack([packed[:, 3] >> 24, packed[:, 3] >> 16 & 255, packed[:, 3] >> 8 & 255], axis=1) / 255
    color = chunk[:, 12:15] + color * (chunk[:, 15:18] - chunk[:, 12:15])
    return spread(packed[:, 0], 0), quaternion, np.exp(spread(packed[:, 2], 6)), (packed[:, 3] & 255) / 255, color
