"""Camera paths from a JSON file of named cameras.

`{"pixel_center": "integer" | "half", "cameras": [{"name", "width", "height", "K", "R", "t", "frame"?}]}`: world to
camera, OpenCV axes, metres. With `frame`, a source frame number, a camera serves that frame only, without it every
frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.storage.model.cameras import CameraPath, camera_centre, from_integer_centres, rigid
from posegaussian.storage.model.documents import read_json
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.plausible import check_camera, check_place

REQUIRED = ("name", "width", "height", "K", "R", "t")
FORM = '{"pixel_center": "integer" or "half", "cameras": [{"name", "width", "height", "K", "R", "t", "frame"?}]}'


def read_path_file(file: str, source_frames: np.ndarray) -> CameraPath:
    """The cameras of a path file over the frames [F] of a sequence, in order of first mention.

    A frame that a camera does not serve has `served` False and the pose of the camera's last entry. Raises UserError
    for a file that cannot be read or parsed (with the line), for missing or unknown keys, numbers that are not finite,
    rotations off a rigid one by more than 1e-3, a camera twice in one frame, two sizes of one name, and when no frame
    is served.
    """
    document = _parse(file)
    unknown = sorted(set(document) - {"pixel_center", "cameras"})
    if unknown:
        raise UserError(f"{file}: unknown key {unknown[0]!r}; the form is {FORM}")
    centre = document.get("pixel_center")
    if centre not in ("integer", "half"):
        said = "is missing" if centre is None else f"is {centre!r}"
        raise UserError(
            f'{file}: "pixel_center" {said}; write "integer" if the centre of the top-left pixel is (0, 0) as in'
            ' OpenCV, "half" if it is (0.5, 0.5)'
        )
    entries = document.get("cameras")
    if not isinstance(entries, list) or not entries:
        raise UserError(f'{file}: "cameras" must be a list of at least one camera; the form is {FORM}')
    cameras = [_camera(file, i, e, centre == "integer") for i, e in enumerate(entries)]
    names = tuple(dict.fromkeys(c["name"] for c in cameras))
    row = {int(n): i for i, n in enumerate(source_frames)}
    shape = (len(source_frames), len(names))
    served, k, pose, size = (
        np.zeros(shape, bool),
        np.zeros((*shape, 3, 3)),
        np.zeros((*shape, 4, 4)),
        np.zeros((len(names), 2), np.int64),
    )
    seen: set[tuple[str, int | None]] = set()
    for camera in cameras:
        name, frame, c = camera["name"], camera["frame"], names.index(camera["name"])
        every = {f for n, f in seen if n == name}
        if frame in every or (every and (frame is None or None in every)):
            when = "every frame" if frame is None else f"frame {frame}"
            raise UserError(
                f"{file}: camera {name!r} serves {when} and occurs there more than once;"
                " names are unique for each frame"
            )
        seen.add((name, frame))
        if size[c].any() and (size[c] != camera["size"]).any():
            raise UserError(
                f"{file}: camera {name!r} is {size[c][0]}x{size[c][1]} px and {camera['size'][0]}x{camera['size'][1]}"
                " px; one name has one size"
            )
        size[c] = camera["size"]
        frames = slice(None) if frame is None else [row[frame]] if frame in row else []
        served[frames, c], k[frames, c], pose[frames, c] = True, camera["intrinsics"], camera["world_to_camera"]
    for camera in cameras:
        c = names.index(camera["name"])
        k[~served[:, c], c], pose[~served[:, c], c] = camera["intrinsics"], camera["world_to_camera"]
    if not served.any():
        wanted = sorted({c["frame"] for c in cameras})
        raise UserError(
            f'{file}: "frame" {wanted[0]}..{wanted[-1]} is not among the sequence\'s source frames'
            f" {source_frames[0]}..{source_frames[-1]}; see frames.range"
        )
    return CameraPath("file", names, k, pose, size, served)


def _parse(file: str) -> dict[str, Any]:
    document = read_json(file, "camera path")
    if not isinstance(document, dict):
        raise UserError(f"{file}: the top of the file must be an object; the form is {FORM}")
    return document


def _camera(file: str, index: int, entry: Any, integer: bool) -> dict[str, Any]:
    """One camera, checked and in our convention: name, frame, size [2], intrinsics [3, 3], world_to_camera [4, 4]."""
    if not isinstance(entry, dict):
        raise UserError(f"{file}: cameras[{index}] is not an object; the form is {FORM}")
    name = entry.get("name")
    label = f"{file}: camera {name!r}" if name else f"{file}: cameras[{index}]"
    missing, unknown = [k for k in REQUIRED if k not in entry], [k for k in entry if k not in (*REQUIRED, "frame")]
    if missing or unknown:
        raise UserError(
            f"{label}: {'missing ' + ', '.join(missing) if missing else 'unknown key ' + ', '.join(unknown)}; the keys"
            f" are {', '.join(REQUIRED)} and frame"
        )
    if not isinstance(name, str) or not name.strip() or name in (".", "..") or any(ch in name for ch in "/\\\0"):
        raise UserError(
            f"{label}: the name must be a text without slashes, because it names the folder of its pictures"
        )
    frame = entry.get("frame")
    if frame is not None and (isinstance(frame, bool) or not isinstance(frame, int)):
        raise UserError(f"{label}: frame {frame!r} must be a source frame number; leave it out to serve every frame")
    width, height = (_side(label, key, entry[key]) for key in ("width", "height"))
    intrinsics, r, t = (
        _numbers(label, "K", entry["K"], (3, 3)),
        _numbers(label, "R", entry["R"], (3, 3)),
        _numbers(label, "t", entry["t"], (3,)),
    )
    if (
        intrinsics[0, 0] <= 0
        or intrinsics[1, 1] <= 0
        or np.abs(intrinsics[[1, 2, 2, 2], [0, 0, 1, 2]] - [0, 0, 0, 1]).max() > 1e-9
    ):
        raise UserError(
            f"{label}: K must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
            f" in px with positive fx and fy, got {entry['K']}"
        )
    off = float(np.abs(r @ r.T - np.eye(3)).max())
    if off > 1e-3 or np.linalg.det(r) < 0:
        raise UserError(
            f"{label}: R is off a rotation by {off:.2g} (bound 1e-3), determinant {np.linalg.det(r):.3f}; it must turn"
            " world axes into OpenCV camera axes"
        )
    k = from_integer_centres(intrinsics) if integer else intrinsics
    pose = rigid(r, t)
    check_camera(f"{name!r} of {file}", k, np.zeros(8), np.array([width, height]))
    check_place(f"{name!r} of {file}", t, camera_centre(pose), apart=0.0)
    return {
        "name": name,
        "frame": frame,
        "size": np.array([width, height]),
        "intrinsics": k,
        "world_to_camera": pose,
    }


def _side(label: str, key: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 32768:
        raise UserError(f"{label}: {key} {value!r} must be a whole number of px from 1 to 32768")
    return value


def _numbers(label: str, key: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if shape == (3,) and array.shape in ((3, 1), (1, 3)):
        array = array.reshape(3)
    if array.shape != shape:
        raise UserError(f"{label}: {key} must be {' x '.join(map(str, shape))} numbers")
    if not np.isfinite(array).all():
        raise UserError(f"{label}: {key} holds {array[~np.isfinite(array)][0]}; every number must be finite")
    return array
