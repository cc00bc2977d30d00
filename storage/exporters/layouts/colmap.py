"""COLMAP's layout: `images`, `masks`, a binary model in `sparse/0`, one PINHOLE camera a camera, one image a picture.

Poses are in metres. Points have no tracks: they come from Gaussians, not from matches. Format:
https://colmap.github.io/format.html; `storage/formats/colmap_model.py` reads it.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from posegaussian.storage.exporters.layouts.declaration import Layout, Recording
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.formats.colmap_model import MODELS

PINHOLE = next(number for number, (name, _) in MODELS.items() if name == "PINHOLE")
MODEL = Path("sparse") / "0"


def write(folder: Path, recording: Recording) -> None:
    """Write cameras.bin, images.bin and points3D.bin. Raises NotWritten."""
    rig = recording.rig
    cameras = [struct.pack("<Q", len(rig))]
    for v, k in enumerate(rig.intrinsics):
        width, height = (int(n) for n in rig.size[v])
        cameras.append(struct.pack("<IiQQ4d", v + 1, PINHOLE, width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
    every = list(recording.images())
    images = [struct.pack("<Q", len(every))]
    poses = [(quaternion(m[:3, :3]), m[:3, 3]) for m in rig.world_to_camera]
    for at, (v, _, name) in enumerate(every):
        turn, shift = poses[v]
        images.append(struct.pack("<I7dI", at + 1, *turn, *shift, v + 1) + name.encode() + b"\0" + struct.pack("<Q", 0))
    point = np.dtype([("id", "<u8"), ("at", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")])
    points = np.zeros(len(recording.points), point)
    points["id"], points["at"] = np.arange(1, len(points) + 1), recording.points
    points["color"] = recording.colors
    for name, raw in (
        ("cameras.bin", b"".join(cameras)),
        ("images.bin", b"".join(images)),
        ("points3D.bin", struct.pack("<Q", len(points)) + points.tobytes()),
    ):
        write_atomically(folder / MODEL / name, raw)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """[4] (w, x, y, z), w >= 0, of a rotation [3, 3]: the eigenvector of the largest eigenvalue of Bar-Itzhack's
    matrix (2000), which is exact for every angle."""
    r = rotation
    k = np.array(
        [
            [np.trace(r), r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [0, r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [0, 0, r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [0, 0, 0, r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    return q if q[0] >= 0 else -q


LAYOUT = Layout(
    "colmap",
    "images, masks and sparse/0 in binary, for gsplat, brush, OpenSplat and COLMAP itself.",
    write,
    cloud=True,
    still=True,
)
