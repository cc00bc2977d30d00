"""OpenCV's FileStorage as YAML or JSON: intrinsics, distortion and pose of cameras, in one file or one a camera.

A camera is a node with a matrix, distortion in OpenCV's order, and a rotation (matrix or Rodrigues vector) and a
translation, world to camera, as solvePnP and stereoCalibrate return them; several stand under their names, or in a list
`cameras` with a `name` each. The only camera of a file is named by it. Programs spell the keys differently; those of
OpenCV's samples and functions are read. The format has no unit. Pixel centres lie at integers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, begins, fixed
from posegaussian.storage.importers.cameras import RawCamera, numbers, whole_size
from posegaussian.storage.importers.easymocap import read_opencv_yaml
from posegaussian.storage.model.cameras import rotation_matrix
from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError

MATRIX = ("camera_matrix", "cameraMatrix", "K", "mtx")
DISTORTION = ("dist_coeffs", "distCoeffs", "distortion_coefficients", "distortion_coeffs", "dist", "D")
ROTATION = ("R", "rvec", "rotation", "rotation_matrix")
TRANSLATION = ("T", "tvec", "translation", "t")
"""Spellings of the keys, the first that is there counts."""
SAME_TURN = 1e-4
"""By which entries of two rotations of one camera may differ and still be one, rounded."""


def read(path: Path) -> Calibration:
    """The cameras of a file. Raises CalibrationError."""
    if path.suffix.lower() == ".json":
        try:
            data = read_json(path, "calibration")
        except SourceError as e:
            raise CalibrationError(str(e)) from e
    else:
        data = read_opencv_yaml(path)
    nodes = _nodes(data, path)
    return Calibration({n: fixed(_camera(n, g, path)) for n, g in nodes.items()}, "world to camera", False, None)


def _nodes(data: Any, path: Path) -> dict[str, Mapping[str, Any]]:
    """{camera: its node}. Raises CalibrationError where there is none, or two have one name."""
    if isinstance(data, dict) and _is_camera(data):
        return {path.stem: data}
    held = data.get("cameras", data) if isinstance(data, dict) else data
    if isinstance(held, dict):
        found = [(str(n), g) for n, g in held.items() if _is_camera(g)]
    else:
        found = [(str(g.get("name", "")), g) for g in held if _is_camera(g)] if isinstance(held, list) else []
    names = [n for n, _ in found]
    if not found or not all(names) or len(set(names)) < len(names):
        raise CalibrationError(
            f"calibration {path} must hold a camera, with one of {', '.join(MATRIX)}, or cameras of different names; it"
            f" has {shortened(names)}"
        )
    return dict(found)


def _is_camera(node: Any) -> bool:
    return isinstance(node, dict) and any(k in node for k in MATRIX)


def _camera(name: str, given: Mapping[str, Any], path: Path) -> RawCamera:
    if str(given.get("fisheye_model", "0")) not in ("0", "False", "false"):
        raise CalibrationError(f"camera {name}: fisheye_model is set in {path}; calibrate with the pinhole model")
    rotations = [numbers(_plain(given[k]), name, k, [(3,), (3, 3)]) for k in ROTATION if given.get(k) is not None]
    turns = [rotation_matrix(r) if r.size == 3 and (np.abs(r) < 1e6).all() else r for r in rotations]
    if len(turns) > 1 and not all(t.shape == (3, 3) and (np.abs(t - turns[0]) < SAME_TURN).all() for t in turns):
        raise CalibrationError(
            f"camera {name}: {' and '.join(k for k in ROTATION if k in given)} in {path} are different rotations; leave"
            " the one that is meant"
        )
    if not rotations:
        raise _lacks(name, path, ROTATION, "calibrate where the camera stands")
    return RawCamera(
        name,
        numbers(_of(given, MATRIX, name, path, ""), name, "the camera's matrix", [(3, 3)]),
        numbers(
            _of(given, DISTORTION, name, path, "write zeros where there is none"), name, "distortion", [(-1,)]
        ).ravel(),
        rotations[0],
        numbers(_of(given, TRANSLATION, name, path, "calibrate where the camera stands"), name, "translation", [(3,)]),
        _size(given, name),
    )


def _of(given: Mapping[str, Any], spellings: tuple[str, ...], name: str, path: Path, hint: str) -> Any:
    for key in spellings:
        if given.get(key) is not None:
            return _plain(given[key])
    raise _lacks(name, path, spellings, hint)


def _lacks(name: str, path: Path, spellings: tuple[str, ...], hint: str) -> CalibrationError:
    return CalibrationError(f"camera {name}: {path} has none of {', '.join(spellings)}; {hint}")


def _plain(value: Any) -> Any:
    """The numbers of a matrix that is written as rows, cols and data; anything else as it is."""
    return value["data"] if isinstance(value, dict) and "data" in value else value


def _size(given: Mapping[str, Any], name: str) -> tuple[int, int] | None:
    """(width, height) px, where the file says it."""
    if given.get("image_size") is not None:
        value = _plain(given["image_size"])
    elif "image_width" in given and "image_height" in given:
        value = [given["image_width"], given["image_height"]]
    else:
        return None
    return whole_size(value, name)


def _fits(path: Path) -> bool:
    """Whether a camera's matrix is named as OpenCV names it; K alone is one in a file that says it is OpenCV's."""
    endings = (".yml", ".yaml", ".json")
    named = any(begins(path, endings, part, 2**20) for part in MATRIX[:2])
    of_opencv = begins(path, endings, "opencv-matrix", 2**20)
    return named or (of_opencv and any(begins(path, endings, part, 2**20) for part in ("K:", '"K"')))


FORMAT = CalibrationFormat("OpenCV FileStorage", _fits, read, alone=True)
