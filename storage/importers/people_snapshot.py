"""People-Snapshot: one camera that stands still, before which a person turns.

`SUBJECT.mp4`, `camera.pkl` (a pickle of Python 2: camera_f, camera_c, camera_k, camera_rt, camera_t, width, height),
`masks.hdf5` (`masks` [F, h, w], 0 and 1) and `keypoints.hdf5` (`keypoints` [F, 54], the 18 joints of OpenPose's COCO
model). Poses of a body model are not read. Format: https://github.com/thmoa/videoavatars, prepare_data.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.formats.plain_hdf5 import Hdf5File
from posegaussian.storage.formats.plain_pickle import read_pickle
from posegaussian.storage.importers.cameras import RawCamera, build_rig, check_principal_point, numbers
from posegaussian.storage.importers.common import ImportOptions, folder, videos_in
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.films import video_streams
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.errors import CalibrationError, SourceError

CAMERA = "camera.pkl"
FIELDS = ("camera_f", "camera_c", "camera_k", "camera_rt", "camera_t", "width", "height")
COCO17_OF_OPENPOSE = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
"""Joints of OpenPose's COCO model, which has a neck besides, in the order of COCO's own 17."""
OPENPOSE = 18
"""Joints of that model."""


class SnapshotOptions(ImportOptions):
    """The layout leaves nothing else to choose."""


def find(source: Path, options: SnapshotOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    videos = videos_in(base)
    if len(videos) != 1:
        raise SourceError(f"{base} holds {len(videos)} videos ({', '.join(videos) or 'none'}); it must hold one")
    ((name, _),) = videos.items()
    names = options.pick((name,))
    pictures, rate, notes = video_streams(videos, options.frame_rate)
    camera = _camera(base / CAMERA, name)
    check_principal_point(f"camera {name}", camera.intrinsics, camera.size, pictures[0].size)
    rig = build_rig([camera], [pictures[0].size], half=False)
    masks, mask_notes = _masks(base / "masks.hdf5", names[0], pictures[0])
    joints, joint_notes = _joints(base / "keypoints.hdf5", pictures[0])
    return Capture(
        "people_snapshot",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        joints=joints,
        notes=("unit: metres, as the layout has it", *notes, *mask_notes, *joint_notes),
    )


def _camera(path: Path, name: str) -> RawCamera:
    try:
        found: Any = read_pickle(path, "camera")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    lacking = [f for f in FIELDS if not isinstance(found, dict) or f not in found]
    if lacking:
        raise CalibrationError(f"{path} has no {', '.join(lacking)}; is it of another data set?")
    focal, middle = (numbers(found[f], name, f, [(2,)]) for f in ("camera_f", "camera_c"))
    size = numbers([found["width"], found["height"]], name, "width and height", [(2,)])
    if not np.isfinite(size).all():
        raise CalibrationError(f"camera {name}: width and height are {size.tolist()} px; whole numbers are expected")
    return RawCamera(
        name,
        np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1]]),
        numbers(found["camera_k"], name, "camera_k", [(-1,)]),
        numbers(found["camera_rt"], name, "camera_rt", [(3,)]),
        numbers(found["camera_t"], name, "camera_t", [(3,)]),
        (int(size[0]), int(size[1])),
    )


def _masks(path: Path, name: str, pictures: Stream) -> tuple[tuple[Stream, ...], list[str]]:
    if not path.exists():
        return (), [f"there is no {path.name}"]
    shape = Hdf5File(path, "masks").shape("masks")
    if len(shape) != 3 or shape[:0:-1] != tuple(pictures.size):
        raise SourceError(
            f"camera {name}: masks in {path} have the shape {shape}; [frames, {pictures.size[1]}, {pictures.size[0]}]"
            " is expected, as the pictures have it"
        )
    stream, notes = _rows(path, "masks", shape[0], pictures, {})
    return (stream,), notes


def _joints(path: Path, pictures: Stream) -> tuple[tuple[Stream, ...], list[str]]:
    if not path.exists():
        return (), []
    shape = Hdf5File(path, "joints").shape("keypoints")
    if len(shape) != 2 or shape[1] != 3 * OPENPOSE:
        raise SourceError(f"joints in {path} have the shape {shape}; [frames, {3 * OPENPOSE}] is expected")
    options = {"joint_set": "coco17", "picked": list(COCO17_OF_OPENPOSE)}
    stream, notes = _rows(path, "keypoints", shape[0], pictures, options)
    return (stream,), ["2D joints: 17 of OpenPose's 18, joint set coco17", *notes]


def _rows(path: Path, data: str, count: int, pictures: Stream, options: dict[str, Any]) -> tuple[Stream, list[str]]:
    """(an array with a row a frame, notes). Rows go with frames from the first on."""
    frames = tuple(n for n in pictures.numbers if n < count)
    if not frames:
        raise SourceError(f"{path} holds no {data}")
    notes = []
    if count != len(pictures.numbers):
        notes.append(
            f"{path.name} has {count} frames, the video {len(pictures.numbers)}; both are taken to begin together"
        )
    size = pictures.size if data == "masks" else (0, 0)
    return Stream("hdf5", (SourceFile.of(path),), frames, size, {"data": data, **options}), notes


IMPORTER = Importer(
    "people_snapshot",
    "One video, camera.pkl, masks.hdf5 and keypoints.hdf5, as People-Snapshot has them.",
    SnapshotOptions,
    find,
    (
        Trait(CAMERA, lambda base: (base / CAMERA).is_file()),
        Trait("masks.hdf5", lambda base: (base / "masks.hdf5").is_file(), filmed=True),
    ),
)
