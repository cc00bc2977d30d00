"""RealityCapture's (RealityScan's) table "Internal/External camera parameters": a row a picture.

`x`, `y`, `alt` is the camera's place; heading, pitch and roll are degrees and turn a camera that looks along -z with y
up (OpenGL): Rz(-heading) Rx(pitch) Ry(roll). `f` is for a picture 36 wide along its longer side, `px` and `py` are the
principal point from the middle, in longer sides. The unit is the project's. k4 is another coefficient than OpenCV's.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, Sized, begins
from posegaussian.storage.importers.cameras import RawCamera
from posegaussian.storage.model.documents import read_table, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError

FILM = 36.0
"""Longer side that `f` is for."""
COLUMNS = ("x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
_BACKWARDS = np.diag([1.0, -1.0, -1.0])
"""From a camera that looks along -z with y up to one that looks along z with y down."""


def read(path: Path) -> Calibration:
    """The cameras of a table, named by their pictures without endings. Raises CalibrationError."""
    cameras: dict[str, Sized] = {}
    try:
        columns, rows = read_table(path, "calibration")
        lacking = [c for c in COLUMNS if c not in columns]
        if lacking:
            raise CalibrationError(
                f"calibration {path} lacks the columns {', '.join(lacking)}; export Internal/External camera parameters"
            )
        for line, row in rows:
            name = (row.get(columns[0]) or "").replace("\\", "/").rpartition("/")[2].rpartition(".")[0]
            values = {}
            for column in COLUMNS:
                try:
                    values[column] = float(row[column])
                except (TypeError, ValueError):
                    raise CalibrationError(
                        f"calibration {path} line {line}: {column} is {shortened(row[column])}; a number is expected"
                    ) from None
            if not name or name in cameras:
                raise CalibrationError(f"calibration {path} line {line}: camera {name!r} needs a name of its own")
            if values["k4"] != 0:
                raise CalibrationError(
                    f"camera {name}: k4 = {values['k4']:g} has no place in OpenCV's model; align with the model Brown3"
                )
            if not np.isfinite(list(values.values())).all():
                raise CalibrationError(f"calibration {path} line {line}: every number must be finite")
            cameras[name] = partial(_camera, name, values)
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    return Calibration(cameras, "camera to world by heading, pitch and roll", True, None)


def _camera(name: str, values: dict[str, float], size: tuple[int, int]) -> RawCamera:
    side = max(size)
    focal = values["f"] * side / FILM
    middle = [values["px"] * side + size[0] / 2, values["py"] * side + size[1] / 2]
    heading, pitch, roll = (np.radians(values[k]) for k in ("heading", "pitch", "roll"))
    to_world = _turn(2, -heading) @ _turn(0, pitch) @ _turn(1, roll)
    rotation = _BACKWARDS @ to_world.T
    return RawCamera(
        name,
        np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]]),
        np.array([values["k1"], values["k2"], values["t1"], values["t2"], values["k3"]]),
        rotation,
        -rotation @ np.array([values["x"], values["y"], values["alt"]]),
        size,
    )


def _turn(axis: int, angle: float) -> np.ndarray:
    """[3, 3] about one axis."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[a, a] = out[b, b] = np.cos(angle)
    out[b, a], out[a, b] = np.sin(angle), -np.sin(angle)
    return out


FORMAT = CalibrationFormat("RealityCapture CSV", lambda p: begins(p, (".csv",), "heading,pitch,roll"), read)
