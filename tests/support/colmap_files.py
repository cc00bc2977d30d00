"""COLMAP's model as its documentation describes it, of the capture in `import_capture`; nothing of ours writes it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posegaussian.storage.importers.cameras import rotation_matrix
from tests.support import import_capture

OPENCV = 4
NAMES = {0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV", 5: "OPENCV_FISHEYE"} | {
    6: "FULL_OPENCV",
    7: "FOV",
}


class Camera(NamedTuple):
    model: int
    size: tuple[int, int]
    params: tuple[float, ...]


class Image(NamedTuple):
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int
    name: str
    seen: tuple[tuple[float, float, int], ...] = ()


class Model(NamedTuple):
    cameras: dict[int, Camera]
    images: list[Image]
    points: np.ndarray
    """[n, 3], ids from 1."""


def quaternion(rodrigues: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    """(w, x, y, z): half the angle about the axis."""
    angle = float(np.linalg.norm(rodrigues))
    return (float(np.cos(angle / 2)), *(np.sin(angle / 2) * np.asarray(rodrigues) / angle).tolist())


def opencv_params(v: int, shift: float = 0.5) -> tuple[float, ...]:
    """Parameters fx fy cx cy k1 k2 p1 p2; COLMAP's principal point lies half a pixel further than OpenCV's."""
    k = import_capture.K[v]
    return (k[0, 0], k[1, 1], k[0, 2] + shift, k[1, 2] + shift, *import_capture.DISTORTION[v])


def points() -> np.ndarray:
    """[40, 3] around the known point."""
    return import_capture.POINT + 0.25 * np.random.default_rng(5).uniform(-1, 1, (40, 3))


def seen(v: int) -> tuple[tuple[float, float, int], ...]:
    """Where camera v sees the points, by the equations written out."""
    rotation = rotation_matrix(import_capture.RODRIGUES[v])
    pixels = [
        import_capture.project(
            import_capture.K[v], import_capture.DISTORTION[v], rotation, import_capture.TRANSLATION[v], p
        )
        for p in points()
    ]
    return tuple((float(u) + 0.5, float(w) + 0.5, i + 1) for i, (u, w) in enumerate(pixels))


def rig(names: Sequence[str] = ("cam1/000000.png", "cam2/000000.png", "cam10/000000.png"), unit: float = 1.0) -> Model:
    """One image of each camera; `unit` metres in a unit of the model."""
    return Model(
        {v + 1: Camera(OPENCV, import_capture.SIZE, opencv_params(v)) for v in range(3)},
        [
            Image(
                quaternion(import_capture.RODRIGUES[v]),
                tuple((import_capture.TRANSLATION[v] / unit).tolist()),
                v + 1,
                name,
                seen(v),
            )
            for v, name in enumerate(names)
        ],
        points() / unit,
    )


def write_text(folder: Path, model: Model) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [
        f"{key} {NAMES[c.model]} {c.size[0]} {c.size[1]} {' '.join(map(repr, map(float, c.params)))}"
        for key, c in model.cameras.items()
    ]
    (folder / "cameras.txt").write_text("\n".join(["# Camera list", *cameras, ""]))
    images = []
    for at, i in enumerate(model.images):
        pose = " ".join(repr(float(x)) for x in (*i.quaternion, *i.translation))
        images += [f"{at + 1} {pose} {i.camera} {i.name}", " ".join(f"{x!r} {y!r} {k}" for x, y, k in i.seen)]
    (folder / "images.txt").write_text("\n".join(["# Image list with two lines of data per image", *images, ""]))
    lines = [
        f"{k + 1} {p[0]!r} {p[1]!r} {p[2]!r} 10 20 30 0.5 1 {k} 2 {k}" for k, p in enumerate(model.points.tolist())
    ]
    (folder / "points3D.txt").write_text("\n".join(["# 3D point list", *lines, ""]))


def write_binary(folder: Path, model: Model) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    raw = struct.pack("<Q", len(model.cameras))
    for key, c in model.cameras.items():
        raw += struct.pack(f"<IiQQ{len(c.params)}d", key, c.model, *c.size, *c.params)
    (folder / "cameras.bin").write_bytes(raw)
    raw = struct.pack("<Q", len(model.images))
    for at, i in enumerate(model.images):
        raw += struct.pack("<I7dI", at + 1, *i.quaternion, *i.translation, i.camera) + i.name.encode() + b"\0"
        raw += struct.pack("<Q", len(i.seen))
        raw += b"".join(struct.pack("<ddQ", x, y, k if k >= 0 else 2**64 - 1) for x, y, k in i.seen)
    (folder / "images.bin").write_bytes(raw)
    raw = struct.pack("<Q", len(model.points))
    for k, p in enumerate(model.points.tolist()):
        raw += struct.pack("<Q3d3Bd", k + 1, *p, 10, 20, 30, 0.5) + struct.pack("<Q4I", 2, 1, k, 2, k)
    (folder / "points3D.bin").write_bytes(raw)


WRITE = {"text": write_text, "binary": write_binary}
