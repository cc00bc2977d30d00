"""nerfstudio's layout: `transforms.json` with every camera's intrinsics, poses in metres (OpenGL axes), `time` from 0
to 1 where there are several instants, and a cloud `points.ply`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.exporters.layouts.declaration import IMAGES, MASKS, Layout, Recording
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.cameras import camera_centre

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera axes to OpenGL's."""
CLOUD = "points.ply"


def write(folder: Path, recording: Recording) -> None:
    """Write transforms.json and points.ply. Raises NotWritten."""
    instants = recording.instants
    first, span = instants[0], max(1, instants[-1] - instants[0])
    frames: list[dict[str, Any]] = []
    for v, n, name in recording.images():
        frame = {"file_path": f"{IMAGES}/{name}", **_camera(recording, v), "transform_matrix": _pose(recording, v)}
        if recording.masks:
            frame["mask_path"] = f"{MASKS}/{name}"
        if len(instants) > 1:
            frame["time"] = (n - first) / span
        frames.append(frame)
    data = {"camera_model": "OPENCV", "ply_file_path": CLOUD, **_splits(recording), "frames": frames}
    write_atomically(folder / "transforms.json", json.dumps(data, allow_nan=False, indent=1).encode())
    write_atomically(folder / CLOUD, cloud(recording.points, recording.colors))


def _camera(recording: Recording, v: int) -> dict[str, Any]:
    k, size = recording.rig.intrinsics[v], recording.rig.size[v]
    return {
        "camera_label": recording.rig.names[v],
        "w": int(size[0]),
        "h": int(size[1]),
        "fl_x": float(k[0, 0]),
        "fl_y": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
    }


def _pose(recording: Recording, v: int) -> list[list[float]]:
    """Camera to world, [4][4]."""
    m = recording.rig.world_to_camera[v]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = m[:3, :3].T, camera_centre(m)
    found: list[list[float]] = (pose @ OPENGL).tolist()
    return found


def _splits(recording: Recording) -> dict[str, list[str]]:
    """Pictures to train on and to compare with, where cameras are held out; nerfstudio wants all three then."""
    if not recording.held_out:
        return {}
    names: dict[bool, list[str]] = {True: [], False: []}
    for v, _, name in recording.images():
        names[recording.rig.names[v] in recording.held_out].append(f"{IMAGES}/{name}")
    return {"train_filenames": names[False], "val_filenames": names[True], "test_filenames": names[True]}


def cloud(points: np.ndarray, colors: np.ndarray) -> bytes:
    """A binary PLY of coloured points: float32 metres, uint8 sRGB."""
    row = np.dtype([(a, "<f4") for a in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])
    table = np.zeros(len(points), row)
    for at, (axis, color) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        table[axis], table[color] = points[:, at], colors[:, at]
    properties = "".join(f"property float {a}\n" for a in "xyz")
    properties += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}end_header\n"
    return head.encode() + table.tobytes()


LAYOUT = Layout(
    "nerfstudio",
    "images, masks, transforms.json and points.ply, for nerfstudio and its relatives.",
    write,
    cloud=True,
    still=True,
)
