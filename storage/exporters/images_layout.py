"""A capture out, in the layout that `importers/images.py` reads: importing what this writes gives back every value."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.files.names import check_camera_names
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.readers.images import write_exr, write_png


def write_capture(
    folder: str | Path,
    rig: Rig,
    color: np.ndarray | None,
    mask: np.ndarray | None = None,
    joints2d: np.ndarray | None = None,
    depth: np.ndarray | None = None,
    frame_rate: float = 30.0,
    numbers: Sequence[int] | np.ndarray | None = None,
    depth_maps: np.ndarray | None = None,
    held_out: Sequence[str] = (),
) -> None:
    """Write a capture of F frames and V views; pictures smaller than the arrays are cut to the rig's size.

    color [F, V, h, w, 3]: uint8 sRGB as PNG, float16 linear as EXR. mask [F, V, h, w] uint8. joints2d [F, V, J, 3] of
    one person, or [F, V, people, J, 3], (u, v, score) in our pixel centres. depth [F, V, h, w] float32 metres, 0 = no
    surface, is true depth; depth_maps, the same to reconstruct from. numbers [F] source frame numbers, 0..F-1 by
    default. What is None is left as it is, so that a long capture may be written in parts: pictures of some frames at a
    time, the joints of a camera at once. `held_out` names cameras that only metrics may look at. Raises ValueError when
    an array is smaller than the rig's pictures, and NotWritten.
    """
    check_camera_names(rig.names)
    root = Path(folder)
    frames = np.arange(0 if color is None else len(color)) if numbers is None else np.asarray(numbers)
    _write_json(root / "cameras.json", _cameras(rig, frame_rate, held_out))
    for kind, array in (("images", color), ("masks", mask), ("depth", depth), ("depth_maps", depth_maps)):
        if array is None:
            continue
        for v, name in enumerate(rig.names):
            width, height = (int(n) for n in rig.size[v])
            if array.shape[2] < height or array.shape[3] < width or len(array) != len(frames):
                raise ValueError(
                    f"{kind} {array.shape} do not cover {len(frames)} frames of {width}x{height} px of camera {name}"
                )
            for n, picture in zip(frames, array[:, v, :height, :width], strict=True):
                suffix, write = ("png", write_png) if picture.dtype == np.uint8 else ("exr", write_exr)
                write(root / kind / name / f"{int(n):06d}.{suffix}", picture)
    if joints2d is not None:
        people = joints2d[:, :, None] if joints2d.ndim == 4 else joints2d
        for v, name in enumerate(rig.names):
            _write_json(root / "joints" / f"{name}.json", _coco(frames, people[:, v]))


def _cameras(rig: Rig, frame_rate: float, held_out: Sequence[str]) -> dict[str, Any]:
    entries = [
        {
            "name": name,
            "width": int(rig.size[v, 0]),
            "height": int(rig.size[v, 1]),
            "K": rig.intrinsics[v].tolist(),
            "R": rig.rotations[v].tolist(),
            "t": rig.world_to_camera[v, :3, 3].tolist(),
            "distortion": rig.distortion[v].tolist(),
            **({"held_out": True} if name in held_out else {}),
        }
        for v, name in enumerate(rig.names)
    ]
    return {"pixel_center": "half", "frame_rate": float(frame_rate), "cameras": entries}


def _coco(frames: np.ndarray, people: np.ndarray) -> dict[str, Any]:
    """COCO keypoints of one view, [F, people, J, 3]; the scores beside the visibilities, so that nothing is rounded."""
    images = [{"id": i, "file_name": f"{int(n):06d}.png"} for i, n in enumerate(frames)]
    annotations: list[dict[str, Any]] = []
    for i, found in enumerate(people):
        for person in found:
            visible = np.where(person[:, 2:] > 0, 2.0, 0.0)
            annotations.append(
                {
                    "id": len(annotations),
                    "image_id": i,
                    "category_id": 1,
                    "num_keypoints": int((person[:, 2] > 0).sum()),
                    "keypoints": (
                        np.concatenate([person[:, :2], visible], axis=1).astype(np.float64).reshape(-1).tolist()
                    ),
                    "keypoint_scores": person[:, 2].astype(np.float64).tolist(),
                }
            )
    return {
        "pixel_center": "half",
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": "person"}],
    }


def _write_json(path: Path, data: dict[str, Any]) -> None:
    write_atomically(path, json.dumps(data, indent=None, allow_nan=False).encode())
