"""One small made capture, from which each importer's test writes its layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.readers.images import write_png

SIZE = (64, 48)
"""(width, height) px."""
POINT = np.array([0.21, -0.13, 0.4])
"""The known point, metres."""
NAMES = ("cam1", "cam2", "cam10")
RODRIGUES = np.array([[0.1, 0.2, -0.3], [1.2, -0.4, 0.3], [-0.2, 2.9, 0.1]])
TRANSLATION = np.array([[0.05, -0.1, 3.0], [0.2, 0.1, 2.5], [-0.1, 0.0, 4.0]])
K = np.array([[[70.0 + i, 0, 31.0 - i], [0, 71.0 + i, 24.5 + i], [0, 0, 1]] for i in range(3)])
"""Intrinsics with pixel centres at integers."""
DISTORTION = np.array([[-0.05, 0.15, 1e-3, 6e-4], [0.03, -0.1, -1e-3, 2e-3], [0.0, 0.0, 0.0, 0.0]])


def project(
    k: np.ndarray, distortion: np.ndarray, rotation: np.ndarray, translation: np.ndarray, point: np.ndarray
) -> np.ndarray:
    """(u, v) in the convention of `k`, by the pinhole and Brown-Conrady equations written out."""
    x, y, z = rotation @ point + translation
    x, y = x / z, y / z
    k1, k2, p1, p2 = distortion[:4]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.array([k[0, 0] * xd + k[0, 2], k[1, 1] * yd + k[1, 2]])


def known_pixels() -> np.ndarray:
    """[V, 2] the known point in each camera, pixel centres at integers."""
    return np.stack(
        [project(K[v], DISTORTION[v], rotation_matrix(RODRIGUES[v]), TRANSLATION[v], POINT) for v in range(3)]
    )


def imported_pixels(rig: Rig) -> np.ndarray:
    """[V, 2] the known point in each camera of an imported rig."""
    m = rig.world_to_camera
    return np.stack(
        [project(rig.intrinsics[v], rig.distortion[v], m[v, :3, :3], m[v, :3, 3], POINT) for v in range(len(rig))]
    )


def people(v: int) -> np.ndarray:
    """[25, 3] one person whose joint j sits 0.25 j px beside the known point; joint 3 is missing."""
    out = np.column_stack([known_pixels()[v] + 0.25 * np.arange(25)[:, None], np.full(25, 0.75)])
    out[3] = 0
    return out


def pictures(
    root: Path, names: tuple[str, ...] = NAMES, frames: tuple[int, ...] = (0, 1, 2), size: tuple[int, int] = SIZE
) -> None:
    """`root/NAME/000000.png`, grey that tells frame and view."""
    for v, name in enumerate(names):
        (root / name).mkdir(parents=True, exist_ok=True)
        for n in frames:
            write_png(root / name / f"{n:06d}.png", np.full((size[1], size[0], 3), 10 * n + v, np.uint8))


def dump(path: Path, data: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))
